#!/bin/sh
# cancel.sh JOB...: delete the jobs and their pods.
set -eu
kubectl delete job --ignore-not-found --wait=false "$@"
