# Everything on a fresh machine with Rust and Python 3: `make drive`, `make test`.

PYTHON ?= python3
CARGO ?= cargo

.PHONY: drive test build lint bench interop soak clean

# A lap of the lake in the headless simulator: first by the expert, who knows the road, then by the shipped model.
drive: build
	target/release/lapwing drive --track lake --laps 1 --speed 20 --pilot expert --recordings runs
	target/release/lapwing drive --track lake --laps 1 --recordings runs

test: .libtorch/build-version
	$(CARGO) test --release

build: .libtorch/build-version
	$(CARGO) build --release

lint: .libtorch/build-version
	$(CARGO) fmt --check
	$(CARGO) clippy --release --all-targets -- -D warnings

bench: .libtorch/build-version
	$(CARGO) bench

# Real clients against the real bridge; needs Node.js with npm, and fetches from PyPI and npm.
interop: build
	$(PYTHON) tests/interop/run.py

# A million telemetries from four simulators in rough company; some twenty minutes, not part of the gate.
soak: build
	$(PYTHON) tests/interop/soak.py

# A libtorch of the user's own, named by these variables, needs no fetching.
.libtorch/build-version:
	@if [ -z "$$LIBTORCH" ] && [ -z "$$LIBTORCH_USE_PYTORCH" ]; then $(PYTHON) scripts/libtorch.py; fi

clean:
	$(CARGO) clean
