#!/bin/sh
# denoise.sh FILE [OUTPUT]: one cloud through the service with curl alone.
# PCDNF_URL is the service (http://127.0.0.1:8000), PCDNF_API_KEY its key where it asks for one.
set -eu
file=$1
output=${2:-${file%.*}_denoised.${file##*.}}
url=${PCDNF_URL:-http://127.0.0.1:8000}

ask() {
    if [ -n "${PCDNF_API_KEY:-}" ]; then
        # the key goes in through a file descriptor, not on a command line that everybody can list
        printf 'header = "Authorization: Bearer %s"\n' "$PCDNF_API_KEY" | curl -sS --fail-with-body --config - "$@"
    else
        curl -sS --fail-with-body "$@"
    fi
}

field() { # field NAME: a member of the JSON object on standard input; a problem in its place ends the script
    python3 -c 'import json, sys
answer = json.load(sys.stdin)
if sys.argv[1] not in answer: sys.exit("{detail} {hint}".format(**{"hint": "", "detail": answer} | answer))
print(answer[sys.argv[1]])' "$1"
}

# The key makes the request safe to repeat: curl tries again after 429, 503 or a lost answer, and no second job is made.
job=$(ask --retry 8 --retry-connrefused -H "Idempotency-Key: $(date +%s)-$$" -F "file=@$file" "$url/denoise" | field id)
echo "job $job" >&2
while :; do
    status=$(ask "$url/jobs/$job" | field status)
    case $status in
        succeeded) break ;;
        failed | cancelled) ask "$url/jobs/$job" | field problem >&2; exit 1 ;;
    esac
    sleep 1
done
ask -o "$output.part" "$url/jobs/$job/result"
mv "$output.part" "$output"
echo "$output"
