#!/bin/sh
# A step of action.yml: builds the program unless it was cached, and puts it on the PATH of the steps that follow.
set -eu
[ -x "$GITHUB_ACTION_PATH/target/release/lapwing" ] || make -C "$GITHUB_ACTION_PATH" build
echo "$GITHUB_ACTION_PATH/target/release" >> "$GITHUB_PATH"
