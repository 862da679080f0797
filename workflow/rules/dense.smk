# Dense stereo in three steps: undistorted photos, depth maps, the fused cloud. What is large goes
# when it is fused, unless keep.dense asks for it; later stages read cameras, evidence and depths.


rule undistort_photos:
    input:
        model="results/{tree}/sfm/model/images.bin",
        photos=photos_of,
    output:
        images=large(directory("results/{tree}/dense/images")),
        sparse=large(directory("results/{tree}/dense/sparse")),
        cameras=ensure("results/{tree}/dense/poses.npz", non_empty=True),
    log:
        "logs/undistort_photos/{tree}.log",
    benchmark:
        "benchmarks/undistort_photos/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("undistort_photos")
    resources:
        **resources_for("undistort_photos"),
    params:
        **stage_params("undistort_photos"),
    message:
        "{wildcards.tree}: undistort the photos"
    script:
        "../../scripts/undistort_photos.py"


# One raster a photo, which all ask who want to know what the photos show.
rule gather_evidence:
    input:
        images="results/{tree}/dense/images",
        cameras="results/{tree}/dense/poses.npz",
        sky_masks="results/{tree}/sky",
        lenses="results/{tree}/sfm/model/cameras.bin",
    output:
        evidence=directory("results/{tree}/evidence"),
    log:
        "logs/gather_evidence/{tree}.log",
    benchmark:
        "benchmarks/gather_evidence/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: 1
    resources:
        **resources_for("gather_evidence"),
    params:
        code=code("gather_evidence"),
    message:
        "{wildcards.tree}: tell clear sky, thin wood and solids in the photos"
    script:
        "../../scripts/gather_evidence.py"


rule estimate_depth:
    input:
        images="results/{tree}/dense/images",
        sparse="results/{tree}/dense/sparse",
        evidence="results/{tree}/evidence",
    output:
        maps=large(directory("results/{tree}/dense/stereo")),
        depth=directory("results/{tree}/depth"),
        report=ensure("results/{tree}/dense/depth.json", non_empty=True),
    log:
        "logs/estimate_depth/{tree}.log",
    benchmark:
        "benchmarks/estimate_depth/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("estimate_depth")
    resources:
        **resources_for("estimate_depth"),
        gpu=stereo_gpus,
    params:
        **stage_params("estimate_depth"),
        several=is_of_several,
    message:
        "{wildcards.tree}: estimate depth maps"
    script:
        "../../scripts/estimate_depth.py"


rule fuse_depth:
    input:
        images="results/{tree}/dense/images",
        sparse="results/{tree}/dense/sparse",
        maps="results/{tree}/dense/stereo",
        report="results/{tree}/dense/depth.json",
        cameras="results/{tree}/dense/poses.npz",
        depth="results/{tree}/depth",
        evidence="results/{tree}/evidence",
    output:
        cloud=ensure("results/{tree}/cloud.ply", non_empty=True),
        coverage=ensure("results/{tree}/dense/coverage.json", non_empty=True),
    log:
        "logs/fuse_depth/{tree}.log",
    benchmark:
        "benchmarks/fuse_depth/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("fuse_depth")
    resources:
        **resources_for("fuse_depth"),
    params:
        **stage_params("fuse_depth"),
        several=is_of_several,
    message:
        "{wildcards.tree}: fuse the depth maps"
    script:
        "../../scripts/fuse_depth.py"
