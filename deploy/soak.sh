#!/bin/bash
# Runs the long forms of what the tests do in small, group after group, and prints one table of figures in the end. Exits with 1
# when a group fails, runs out of time, or misses a mark. About an hour on two quiet cores, two thirds of it for damaged input.
#
# QUADRILLE_FUZZ_SECONDS (600) is how long each of the eight kinds of damaged input is tried, each in a process of its own, as many
# at once as there are processors: 8 x 600 s / processors in all, which is 40 minutes on two.
# SOAK_GROUPS may name some of: kills durability streams requests load clients fuzzing.
set -uo pipefail
cd "$(dirname "$0")/.." || exit 1

export QUADRILLE_SOAK=1
export QUADRILLE_FUZZ_SECONDS=${QUADRILLE_FUZZ_SECONDS:-600}
work=$PWD/target/soak
rm -rf "$work"
mkdir -p "$work"
export QUADRILLE_FIGURES=$work/figures.tsv
: >"$QUADRILLE_FIGURES"
began=$(date +%s)

"${CARGO:-cargo}" test --release --locked --test service --no-run 2>&1 | tee "$work/build.log"
built=$(sed -n 's/.*Executable .*(\(.*\))$/\1/p' "$work/build.log" | tail -1)
[ -x "$built" ] || { echo "the tests were not built" >&2; exit 1; }
# Copies, so that whoever builds meanwhile changes nothing here.
tests=$work/tests
export QUADRILLE_BINARY=$work/quadrille
cp "$built" "$tests"
cp target/release/quadrille "$QUADRILLE_BINARY"

# Runs tests of one process, for at most so many seconds; what it prints goes into a file.
run() { # name, seconds, filters and flags
    local name=$1 limit=$2 from status
    shift 2
    from=$(date +%s)
    timeout --kill-after 10 "$limit" "$tests" --nocapture "$@" >"$work/$name.log" 2>&1
    status=$?
    # A name that fits no test passes as well: it must have run one.
    if [ "$status" = 0 ] && ! grep -q '^test result: ok\. [1-9]' "$work/$name.log"; then status="no test ran"; fi
    case $status in
        0) status=ok ;;
        124 | 137) status="out of time after $limit s" ;;
        *) status=FAILED ;;
    esac
    printf '%s\t%s\t%s\t%s\n' "$name" "$(($(date +%s) - from))" "$status" "$work/$name.log" >>"$work/groups.tsv"
    echo "$name: $status after $(($(date +%s) - from)) s"
}

# Tab-separated lines as a table.
table() {
    awk -F '\t' '
        { for (i = 1; i <= NF; i++) { cell[NR, i] = $i; if (length($i) > width[i]) width[i] = length($i) }
          columns = NF > columns ? NF : columns }
        END { for (row = 1; row <= NR; row++) { line = ""
                for (i = 1; i <= columns; i++) line = line sprintf("%-" (width[i] + 2) "s", cell[row, i])
                sub(/ +$/, "", line); print line } }'
}

for group in ${SOAK_GROUPS:-kills durability streams requests load clients fuzzing}; do
    case $group in
        kills) run kills 900 --test-threads 1 kills:: ;;
        durability) run durability 600 --test-threads 1 durable:: ;;
        streams) run streams 600 --test-threads 1 streams:: ;;
        requests) run requests 300 --test-threads 1 requests:: ;;
        load) run load 1500 --test-threads 1 load::a_full ;;
        clients) run clients 1500 --test-threads 1 foreign:: ;;
        fuzzing)
            for target in $("$tests" --list fuzz:: 2>/dev/null | sed -n 's/: test$//p'); do
                # No more at once than there are processors, so that each gets its time.
                while (($(jobs -rp | wc -l) >= $(nproc))); do wait -n; done
                run "${target/::/-}" $((QUADRILLE_FUZZ_SECONDS + 120)) --exact "$target" &
            done
            wait
            ;;
        *) echo "no group is called $group" >&2; exit 1 ;;
    esac
done

echo
echo "$(uname -srm), $(nproc) processors ($(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -1)), load $(cut -d' ' -f1-3 /proc/loadavg)"
echo
{
    printf 'group\twhat\tfigure\tmark\t\n'
    cat "$QUADRILLE_FIGURES"
} | table
echo
{
    printf 'tests\tseconds\tresult\toutput\n'
    sort "$work/groups.tsv"
} | table
echo
echo "$(($(date +%s) - began)) s in all"
if grep -q 'MISSED$' "$QUADRILLE_FIGURES" || cut -f3 "$work/groups.tsv" | grep -qv '^ok$'; then
    echo "MISSED: see above" >&2
    exit 1
fi
