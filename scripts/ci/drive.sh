#!/bin/sh
# A step of action.yml: drives each track, and leaves the runs in $LAPWING_OUT/runs. Exit status 3, after the last track, if a drive
# missed a threshold.
# LAPWING_MODEL (empty: the built-in one), LAPWING_TRACKS and LAPWING_FLAGS, separated by spaces.
set -eu
: "${LAPWING_OUT:=lapwing-out}" "${LAPWING_TRACKS:=lake}" "${LAPWING_FLAGS:=}"
mkdir -p "$LAPWING_OUT/runs"
missed=0
for track in $LAPWING_TRACKS; do
    set -- drive --track "$track" --recordings "$LAPWING_OUT/runs"
    [ -z "${LAPWING_MODEL:-}" ] || set -- "$@" --model "$LAPWING_MODEL"
    # The flags are several words on purpose.
    # shellcheck disable=SC2086
    lapwing "$@" $LAPWING_FLAGS || {
        status=$?
        [ "$status" -eq 3 ] || exit "$status"
        missed=3
    }
done
[ -z "${GITHUB_OUTPUT:-}" ] || echo "driven=true" >> "$GITHUB_OUTPUT"
exit "$missed"
