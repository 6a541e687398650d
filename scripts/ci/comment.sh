#!/bin/sh
# A step of action.yml: puts the summary under the pull request LAPWING_PULL_REQUEST, in place of the one that this account put there
# before. Without a pull request nothing is said. Needs GitHub's gh, and GH_TOKEN with pull-requests: write.
set -eu
: "${LAPWING_OUT:=lapwing-out}"
if [ -z "${LAPWING_PULL_REQUEST:-}" ]; then
    echo "no pull request, no comment"
    exit 0
fi
body="$LAPWING_OUT/comment.md"
if [ -n "${LAPWING_PICTURES_AT:-}" ]; then cat "$LAPWING_OUT/summary.md"; else grep -v '^!\[' "$LAPWING_OUT/summary.md"; fi > "$body"
gh pr comment "$LAPWING_PULL_REQUEST" --body-file "$body" --edit-last --create-if-none
