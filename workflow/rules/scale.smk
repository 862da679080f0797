rule estimate_scale:
    input:
        photos=photos_of,
        cameras="results/{tree}/sfm/model/cameras.bin",
        images="results/{tree}/sfm/model/images.bin",  # differs where any of the model does
        cloud=lambda wildcards: (
            "results/{tree}/denoised.ply"
            if "trunk" in [one["kind"] for one in cfg("scale.references")(wildcards)]
            else []
        ),
    output:
        scale=ensure("results/{tree}/scale.json", non_empty=True),
    log:
        "logs/estimate_scale/{tree}.log",
    benchmark:
        "benchmarks/estimate_scale/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("estimate_scale")
    resources:
        **resources_for("estimate_scale"),
    params:
        **stage_params("estimate_scale", "geometry/interval_factors.yaml"),
        cell=row("scale"),
        dictionary=row("marker_dictionary"),
        sides_m=row("marker_sides_m"),
    message:
        "{wildcards.tree}: find the scale"
    script:
        "../../scripts/estimate_scale.py"


rule scale_cloud:
    input:
        cloud="results/{tree}/denoised.ply",
        poses="results/{tree}/aligned_poses.npz",
        scale="results/{tree}/scale.json",
        crop="results/{tree}/crop.json",
    output:
        metric=ensure("results/{tree}/metric.ply", non_empty=True),
        metric_poses=ensure("results/{tree}/metric_poses.npz", non_empty=True),
        report="results/{tree}/metric.json",
    log:
        "logs/scale_cloud/{tree}.log",
    benchmark:
        "benchmarks/scale_cloud/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("scale_cloud")
    resources:
        **resources_for("scale_cloud"),
    params:
        **stage_params("scale_cloud"),
    message:
        "{wildcards.tree}: scale the cloud"
    script:
        "../../scripts/scale_cloud.py"
