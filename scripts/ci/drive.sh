#!/bin/sh
# A step of action.yml: drives each track, and leaves the runs in $LAPWING_OUT/runs.
# LAPWING_MODEL (empty: the built-in one), LAPWING_TRACKS and LAPWING_FLAGS, separated by spaces.
set -eu
: "${LAPWING_OUT:=lapwing-out}" "${LAPWING_TRACKS:=lake}" "${LAPWING_FLAGS:=}"
mkdir -p "$LAPWING_OUT/runs"
for track in $LAPWING_TRACKS; do
    set -- drive --track "$track" --recordings "$LAPWING_OUT/runs"
    [ -z "${LAPWING_MODEL:-}" ] || set -- "$@" --model "$LAPWING_MODEL"
    # The flags are several words on purpose.
    # shellcheck disable=SC2086
    lapwing "$@" $LAPWING_FLAGS
done
