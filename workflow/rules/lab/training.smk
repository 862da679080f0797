# Training of the two networks, on photos with sky masks and on generated scenes.


rule train_sky:
    output:
        weights=ensure("results/training/sky/sky_unet.npz", non_empty=True),
        metrics=ensure("results/training/sky/metrics.json", non_empty=True),
    log:
        "logs/train_sky.log",
    benchmark:
        "benchmarks/train_sky.tsv"
    conda:
        "../../../envs/learning.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: 6000 * attempt,
        runtime=720,
    params:
        **stage_params("lab/train_sky"),
    message:
        "train the sky network on photos with sky masks"
    script:
        "../../../scripts/lab/train_sky.py"


rule train_segmentation:
    output:
        weights=ensure("results/segmentation/dgcnn.pt", non_empty=True),
        metrics=ensure("results/segmentation/dgcnn.json", non_empty=True),
    log:
        "logs/train_segmentation.log",
    benchmark:
        "benchmarks/train_segmentation.tsv"
    conda:
        "../../../envs/learning.yaml"
    threads: 2
    resources:
        mem_mb=lambda wildcards, attempt: 8000 * attempt,
        runtime=720,
    params:
        **stage_params("lab/train_segmentation"),
        # The scenes and the checkpoint outlive a killed run here, so they are no outputs.
        workspace="results/segmentation/training",
    message:
        "train the point cloud network on generated scenes"
    script:
        "../../../scripts/lab/train_segmentation.py"
