# Everything on a fresh machine with Rust and Python 3: `make drive`, `make test`.

PYTHON ?= python3
CARGO ?= cargo

.PHONY: drive test build lint light deny bench fuzz interop soak dist clean

# A lap of the lake in the headless simulator: first by the expert, who knows the road, then by the shipped model.
drive: build
	target/release/lapwing drive --track lake --laps 1 --speed 20 --pilot expert --recordings runs
	target/release/lapwing drive --track lake --laps 1 --speed 20 --recordings runs

# After an edit in a leaf, only what it touches is built again. What users build is not incremental: rustc leaves undefined
# symbols behind where an incremental build is interrupted (rust-lang/rust#81280); rm -r target/release/incremental mends it.
test lint: export CARGO_INCREMENTAL = 1

# Tests run in parallel, one on each core: further threads of libtorch would only wait for one another.
test: export OMP_NUM_THREADS = 1
test: .libtorch/build-version
	$(CARGO) test --release --workspace

build: .libtorch/build-version
	$(CARGO) build --release -p lapwing

lint: .libtorch/build-version
	$(CARGO) fmt --all --check
	$(CARGO) clippy --release --workspace --all-targets -- -D warnings
	$(CARGO) clippy --release -p lapwing --no-default-features --features bridge -- -D warnings
	$(CARGO) clippy --release -p lapwing --no-default-features --features simulator -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --release --workspace --no-deps

# What needs no libtorch, checked without it: fails where one of these crates asks for it. What it compiles, `lint` needs, too.
light:
	env -u LIBTORCH -u LIBTORCH_USE_PYTORCH $(CARGO) check --release -p lapwing-core -p lapwing-sim -p lapwing-score

# What the program is made of: licences, bans, sources, advisories; and whether NOTICES names it all.
deny:
	$(PYTHON) scripts/deny.py
	$(PYTHON) scripts/notices.py --check

bench: .libtorch/build-version
	$(CARGO) bench

# Real clients against the real bridge; needs Node.js with npm, and Chromium, and fetches from PyPI and npm.
interop: build
	$(PYTHON) tests/interop/run.py

# One archive that starts on a machine without Rust, Python or libtorch; then tried in a root with libc alone.
dist: build
	$(PYTHON) scripts/dist.py --try

# A million telemetries from four simulators in rough company; some twenty minutes, not part of the gate.
soak: build
	$(PYTHON) tests/interop/soak.py

# Each reader of outside bytes fed with whatever breaks it, for a minute; inputs that break one stay in fuzz/artifacts.
# Needs cargo-fuzz (cargo install cargo-fuzz --locked) and a C++ compiler. `cargo test` replays fuzz/corpus without.
FUZZ_SECONDS ?= 60
FUZZ_LIMITS = -timeout=20 -rss_limit_mb=2048 -max_len=16384 -print_final_stats=1
fuzz: .libtorch/build-version
	@command -v cargo-fuzz >/dev/null || { echo "make fuzz needs cargo-fuzz: cargo install cargo-fuzz --locked" >&2; exit 1; }
	for target in $$($(CARGO) fuzz list); do \
	    mkdir -p fuzz/target/corpus/$$target && \
	    $(CARGO) fuzz run --sanitizer none $$target fuzz/target/corpus/$$target fuzz/corpus/$$target -- \
	        -max_total_time=$(FUZZ_SECONDS) $(FUZZ_LIMITS) || exit 1; \
	done

# A libtorch of the user's own, named by these variables, needs no fetching.
.libtorch/build-version:
	@if [ -z "$$LIBTORCH" ] && [ -z "$$LIBTORCH_USE_PYTORCH" ]; then $(PYTHON) scripts/libtorch.py; fi

clean:
	$(CARGO) clean
