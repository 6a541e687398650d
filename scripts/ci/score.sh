#!/bin/sh
# A step of action.yml: scores the runs of $LAPWING_OUT/runs. Leaves score.json, score.xml (JUnit), score.html and summary.md with its
# pictures in $LAPWING_OUT, and adds the summary to the job's. Exit status 3 if a run misses a threshold or got worse, 1 if one cannot
# be scored; the others are reported all the same.
# LAPWING_THRESHOLDS: flags such as --min-completion 100; LAPWING_BASELINE: an earlier score.json.
set -eu
: "${LAPWING_OUT:=lapwing-out}" "${LAPWING_THRESHOLDS:=}"
failed=0
# Thresholds of a lapwing.toml count here, too: a run that misses one is reported below, and so is one that cannot be scored.
lapwing score "$LAPWING_OUT/runs" --json > "$LAPWING_OUT/score.json" || {
    status=$?
    case "$status" in
        1) failed=1 ;;
        3) ;;
        *) exit "$status" ;;
    esac
    # Without any run there is nothing to report.
    [ -s "$LAPWING_OUT/score.json" ] || exit "$status"
}
set -- score "$LAPWING_OUT/runs" --junit "$LAPWING_OUT/score.xml" --html "$LAPWING_OUT/score.html" "--markdown=$LAPWING_OUT/summary.md"
[ -z "${LAPWING_BASELINE:-}" ] || set -- "$@" --against "$LAPWING_BASELINE"
[ -z "${LAPWING_PICTURES_AT:-}" ] || set -- "$@" --pictures-at "$LAPWING_PICTURES_AT"
status=0
# The flags are several words on purpose.
# shellcheck disable=SC2086
lapwing "$@" $LAPWING_THRESHOLDS || status=$?
if [ -n "${GITHUB_STEP_SUMMARY:-}" ] && [ -f "$LAPWING_OUT/summary.md" ]; then
    # A job's summary shows no pictures that lie beside it.
    if [ -n "${LAPWING_PICTURES_AT:-}" ]; then cat "$LAPWING_OUT/summary.md"; else grep -v '^!\[' "$LAPWING_OUT/summary.md"; fi >> "$GITHUB_STEP_SUMMARY"
fi
[ "$failed" -eq 0 ] || exit "$failed"
exit "$status"
