#!/bin/sh
# status.sh JOB: print running, success or failed. A job that is gone has failed; a controller that
# does not answer says nothing about the job.
set -eu

if ! state=$(kubectl get job "$1" --ignore-not-found \
    -o jsonpath='found {.status.succeeded} failed={.status.failed}' 2>/dev/null); then
    echo running
    exit 0
fi
case "$state" in
"" | *failed=[1-9]*) echo failed ;;
"found "[1-9]*) echo success ;;
*) echo running ;;
esac
