#!/bin/sh
# Installs, by apt-get and only where missing, what a build needs beyond Rust; with the argument `test` also what the tests need
# (Python, for clients that share no code with the service).
set -eu

missing=""
command -v cmake >/dev/null 2>&1 || missing="$missing cmake"
command -v c++ >/dev/null 2>&1 || missing="$missing g++"
command -v make >/dev/null 2>&1 || missing="$missing make"
command -v pkg-config >/dev/null 2>&1 || missing="$missing pkg-config"
command -v curl >/dev/null 2>&1 || missing="$missing curl"
# bindgen loads libclang (libclang-cpp, which compilers bring, is another library); LIBCLANG_PATH may point to one elsewhere.
clang="${LIBCLANG_PATH:-}"
for library in /usr/lib/llvm-*/lib/libclang*.so* /usr/lib/*/libclang*.so* /usr/lib/libclang*.so*; do
    case $library in *-cpp.*) continue ;; esac
    [ ! -e "$library" ] || clang=$library
done
[ -n "$clang" ] || missing="$missing libclang-dev"

if [ "${1:-}" = test ]; then
    python3 -c 'import ensurepip, venv' >/dev/null 2>&1 || missing="$missing python3 python3-venv"
fi

if ! command -v cargo >/dev/null 2>&1; then
    echo "cargo is missing: install Rust (https://rustup.rs), then try again" >&2
    exit 1
fi
[ -n "$missing" ] || exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "please install:$missing" >&2
    exit 1
fi
sudo=""
[ "$(id -u)" = 0 ] || sudo="sudo"
echo "installing:$missing"
$sudo apt-get update -qq
# shellcheck disable=SC2086 # one word per package
DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends $missing
