# Build, try out, test and run Quadrille on a fresh Debian or Ubuntu machine that has Rust.
#
# Everything is built in the release profile, so that the HiGHS solver (minutes of C++) is compiled once for all targets.

CARGO ?= cargo
LISTEN ?= 127.0.0.1:8080
SERVE_ARGS ?=

.PHONY: help setup build demo test soak serve lint api

help:
	@echo "make build   the release binary, target/release/quadrille"
	@echo "make demo    plan the 2x2 switch through the service, and judge the result"
	@echo "make test    all tests, kills, load and fuzzing in short"
	@echo "make soak    200 kills, minutes of load, 10 minutes of damaged input of each kind: an hour on two processors; prints the figures"
	@echo "make api     write api/openapi.json and api/schemas anew"
	@echo "make serve   run the service on LISTEN ($(LISTEN))"
	@echo "make lint    formatting, clippy, documentation"

# Installs what is missing of: cmake, a C++ compiler, libclang (all three for HiGHS), pkg-config, curl.
setup:
	@deploy/setup.sh

build: setup
	$(CARGO) build --release --locked

demo: build
	@deploy/demo.sh

test:
	@deploy/setup.sh test
	$(CARGO) test --release --locked
	QUADRILLE_SIMD=sse2 $(CARGO) test --release --locked --lib -- collision:: geometry:: kinematics:: motion:: transition::

# The long forms, group after group; SOAK_GROUPS chooses some.
soak:
	@deploy/setup.sh test
	@deploy/soak.sh

api: setup
	QUADRILLE_WRITE_API=1 $(CARGO) test --release --locked --test service openapi::the_files

serve: build
	target/release/quadrille serve --listen $(LISTEN) $(SERVE_ARGS)

lint: setup
	$(CARGO) fmt --check
	$(CARGO) clippy --release --locked --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --release --locked --no-deps
