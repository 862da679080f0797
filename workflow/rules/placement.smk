rule align_cloud:
    input:
        cloud="results/{tree}/cloud.ply",
        poses="results/{tree}/poses.npz",
        photos=photos_of,
    output:
        aligned=ensure("results/{tree}/aligned.ply", non_empty=True),
        aligned_poses=ensure("results/{tree}/aligned_poses.npz", non_empty=True),
        report="results/{tree}/align.json",
    log:
        "logs/align_cloud/{tree}.log",
    benchmark:
        "benchmarks/align_cloud/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("align_cloud")
    resources:
        **resources_for("align_cloud"),
    params:
        **stage_params("align_cloud"),
    message:
        "{wildcards.tree}: turn the cloud upright, the ground to z = 0"
    script:
        "../../scripts/align_cloud.py"


rule crop_roi:
    input:
        cloud="results/{tree}/aligned.ply",
        poses="results/{tree}/aligned_poses.npz",
    output:
        cropped=ensure("results/{tree}/cropped.ply", non_empty=True),
        report="results/{tree}/crop.json",
    log:
        "logs/crop_roi/{tree}.log",
    benchmark:
        "benchmarks/crop_roi/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("crop_roi")
    resources:
        **resources_for("crop_roi"),
    params:
        **stage_params("crop_roi"),
        several=is_of_several,
    message:
        "{wildcards.tree}: crop to the region of interest"
    script:
        "../../scripts/crop_roi.py"
