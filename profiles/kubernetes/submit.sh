#!/bin/sh
# submit.sh THREADS MEM_MB MINUTES GPUS JOBSCRIPT: create a Kubernetes job, print its name.
# A pod that outgrows its memory is killed and the job fails; Snakemake then tries it with more.
set -eu

: "${CHERRYPICKER_IMAGE:?name the container image}"
: "${CHERRYPICKER_CLAIM:?name the persistent volume claim}"
: "${CHERRYPICKER_MOUNT:?give the path at which pods mount it}"
threads=$1 mem_mb=$2 minutes=$3 gpus=$4 script=$5

gpu_limit=""
if [ "$gpus" -gt 0 ]; then
    gpu_limit="nvidia.com/gpu: \"$gpus\""
fi
kubectl create -o jsonpath='{.metadata.name}' -f - <<YAML
apiVersion: batch/v1
kind: Job
metadata:
  generateName: cherrypicker-
  labels:
    app: cherrypicker
spec:
  backoffLimit: 0
  activeDeadlineSeconds: $((60 * minutes))
  # A job's record goes a day after its end
  ttlSecondsAfterFinished: 86400
  template:
    spec:
      restartPolicy: Never
      containers:
        - name: stage
          image: "$CHERRYPICKER_IMAGE"
          command: ["/bin/sh", "$script"]
          resources:
            requests:
              cpu: "$threads"
              memory: "${mem_mb}M"
            limits:
              memory: "${mem_mb}M"
              $gpu_limit
          volumeMounts:
            - name: work
              mountPath: "$CHERRYPICKER_MOUNT"
      volumes:
        - name: work
          persistentVolumeClaim:
            claimName: "$CHERRYPICKER_CLAIM"
YAML
