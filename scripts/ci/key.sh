#!/bin/sh
# A step of action.yml: a key for the cache of the built program, made of all that it is built from, its network too.
set -eu
cd "$GITHUB_ACTION_PATH"
sources="Cargo.toml Cargo.lock build.rs src crates models scripts/libtorch.py"
# The names are several words on purpose.
# shellcheck disable=SC2086
sum=$(find $sources -type f | LC_ALL=C sort | xargs sha256sum | sha256sum | cut -d ' ' -f 1)
echo "key=$sum" >> "$GITHUB_OUTPUT"
