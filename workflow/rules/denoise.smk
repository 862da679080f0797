# Isolated points and sky silhouettes out of the cropped cloud.


rule denoise_cloud:
    input:
        cloud="results/{tree}/cropped.ply",
        poses="results/{tree}/aligned_poses.npz",
        cameras="results/{tree}/dense/poses.npz",
        evidence="results/{tree}/evidence",
        sky_colors="results/{tree}/sky_colors.npz",
    output:
        denoised=ensure("results/{tree}/denoised.ply", non_empty=True),
        report="results/{tree}/denoise.json",
        removed="results/{tree}/denoise.npz",
    log:
        "logs/denoise_cloud/{tree}.log",
    benchmark:
        "benchmarks/denoise_cloud/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("denoise_cloud")
    resources:
        **resources_for("denoise_cloud"),
    params:
        **stage_params("denoise_cloud"),
    message:
        "{wildcards.tree}: remove outliers and sky silhouettes"
    script:
        "../../scripts/denoise_cloud.py"
