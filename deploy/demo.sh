#!/bin/bash
# Starts the service on a free port, posts the 2x2 switch, shows the plans as they are streamed, saves the last one,
# and has it judged. Fails when anything does.
#
# BUDGET (seconds) and SCENARIO (family/size) may be set.
set -euo pipefail
cd "$(dirname "$0")/.."

binary=target/release/quadrille
scenario=scenarios/${SCENARIO:-switch/2x2}.json
work=$(mktemp -d)
service=
finish() {
    if [ -n "$service" ]; then
        kill "$service" 2>/dev/null || true
        wait "$service" 2>/dev/null || true
    fi
    rm -rf "$work"
}
trap finish EXIT

"$binary" serve --listen 127.0.0.1:0 >"$work/out" 2>"$work/log" &
service=$!
address=
for _ in $(seq 100); do
    address=$(sed -n 's/^listening on //p' "$work/out")
    [ -z "$address" ] || break
    kill -0 "$service" 2>/dev/null || { cat "$work/log" >&2; exit 1; }
    sleep 0.1
done
[ -n "$address" ] || { echo "the service did not start" >&2; exit 1; }
"$binary" health --address "$address"

echo "POST $scenario to http://$address/v1/plan"
if [ -n "${BUDGET:-}" ]; then
    sed "s/\"time_budget_s\": *[0-9.]*/\"time_budget_s\": $BUDGET/" "$scenario" >"$work/problem.json"
else
    cp "$scenario" "$work/problem.json"
fi
number() { sed -n "s/.*\"$1\":\([0-9.e-]*\).*/\1/p" <<<"$2"; }
job=
incumbents=0
shorter=0
last=
state=
mkfifo "$work/events"
curl -sSN --fail-with-body -H 'Content-Type: application/json' --data-binary @"$work/problem.json" \
    "http://$address/v1/plan" >"$work/events" &
request=$!
while IFS= read -r event; do
    # What stands before the plan is enough to show.
    head=${event%%,\"plan\":*}
    case $head in
        *'"type":"queued"'*)
            job=$(sed -n 's/.*"job_id":"\([^"]*\)".*/\1/p' <<<"$head")
            echo "job $job"
            ;;
        *'"type":"incumbent"'*)
            incumbents=$((incumbents + 1))
            duration=$(number duration_s "$head")
            printf 'plan %-3s found after %8.3f s   steps %s   duration %7.3f s\n' "$(number revision "$head")" \
                "$(number found_after_s "$head")" "$(number steps "$head")" "$duration"
            if [ -n "$last" ] && awk "BEGIN { exit !($duration < $last) }"; then shorter=$((shorter + 1)); fi
            last=$duration
            ;;
        *'"type":"terminal"'*)
            state=$(sed -n 's/.*"state":"\([A-Z_]*\)".*/\1/p' <<<"$head")
            echo "$state ($(sed -n 's/.*"termination_reason":"\([A-Z_]*\)".*/\1/p' <<<"$head"))"
            ;;
        *'"type":"started"'* | *'"type":"progress"'*) ;;
        *) echo "$event" >&2 ;;
    esac
done <"$work/events"
wait "$request" || { echo "the request failed" >&2; exit 1; }
[ "$state" = SUCCEEDED ] || { echo "no plan" >&2; exit 1; }

plan=demo-plan.json
curl -sSf "http://$address/v1/jobs/$job/solutions/best" -o "$plan"
echo "saved $plan; the judge says:"
"$binary" verify "$work/problem.json" "$plan"
echo "$incumbents plans, $shorter of them shorter than the one before"
