#!/bin/sh
# A step of action.yml: drives each track, and leaves the runs in $LAPWING_OUT/runs. Exit status 2 at once after wrong usage; otherwise, after
# the last track, 1 if a drive failed, for example with too many bad frames, or 3 if one missed a threshold. If there are runs, the next
# step reports them.
# LAPWING_MODEL (empty: the built-in one), LAPWING_TRACKS and LAPWING_FLAGS, separated by spaces.
set -eu
: "${LAPWING_OUT:=lapwing-out}" "${LAPWING_TRACKS:=lake}" "${LAPWING_FLAGS:=}"
mkdir -p "$LAPWING_OUT/runs"
ended=0
for track in $LAPWING_TRACKS; do
    set -- drive --track "$track" --recordings "$LAPWING_OUT/runs"
    [ -z "${LAPWING_MODEL:-}" ] || set -- "$@" --model "$LAPWING_MODEL"
    # The flags are several words on purpose.
    # shellcheck disable=SC2086
    lapwing "$@" $LAPWING_FLAGS || {
        status=$?
        case "$status" in
            2) exit 2 ;;
            3) [ "$ended" -ne 0 ] || ended=3 ;;
            *) ended=1 ;;
        esac
    }
done
set -- "$LAPWING_OUT"/runs/*.mcap
if [ -n "${GITHUB_OUTPUT:-}" ] && [ -e "$1" ]; then echo "driven=true" >> "$GITHUB_OUTPUT"; fi
exit "$ended"
