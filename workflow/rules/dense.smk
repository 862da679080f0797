# Dense stereo in three steps: undistorted photos, depth maps, the fused cloud.


rule undistort_photos:
    input:
        model="results/{tree}/sfm/model/images.bin",
        photos=photos_of,
        code=code("undistort_photos"),
    output:
        undistorted=ensure("results/{tree}/dense/undistorted.json", non_empty=True),
    log:
        "logs/undistort_photos/{tree}.log",
    benchmark:
        "benchmarks/undistort_photos/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("undistort_photos")
    resources:
        mem_mb=mb_for("undistort_photos"),
        runtime=minutes_for("undistort_photos"),
        gpu=0,
    params:
        max_image_size=cfg("mvs.max_image_size_px"),
    message:
        "{wildcards.tree}: undistort the photos"
    script:
        "../../scripts/undistort_photos.py"


rule estimate_depth:
    input:
        undistorted="results/{tree}/dense/undistorted.json",
        cameras="results/{tree}/sfm/model/cameras.bin",
        sky_masks=sky_masks_for_stereo,
        code=code("estimate_depth"),
    output:
        depth=ensure("results/{tree}/dense/depth.json", non_empty=True),
    log:
        "logs/estimate_depth/{tree}.log",
    benchmark:
        "benchmarks/estimate_depth/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("estimate_depth")
    resources:
        mem_mb=mb_for("estimate_depth"),
        runtime=minutes_for("estimate_depth"),
        gpu=stereo_gpus,
    params:
        backend=cfg("mvs.backend"),
        n_sources=cfg("mvs.n_sources"),
        n_best=cfg("mvs.n_best"),
        n_iterations=cfg("mvs.n_iterations"),
        window_radius=cfg("mvs.window_radius"),
        color_spread=cfg("mvs.color_spread"),
        min_texture=cfg("mvs.min_texture"),
        max_cost=cfg("mvs.max_cost"),
        geometric_weight=cfg("mvs.geometric_weight"),
        max_error_px=cfg("mvs.max_error_px"),
        min_consistent=cfg("mvs.min_consistent"),
        seed=cfg("seed"),
    message:
        "{wildcards.tree}: estimate depth maps"
    script:
        "../../scripts/estimate_depth.py"


rule fuse_depth:
    input:
        depth="results/{tree}/dense/depth.json",
        cameras="results/{tree}/sfm/model/cameras.bin",
        sky_masks="results/{tree}/sky",
        code=code("fuse_depth"),
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
        mem_mb=mb_for("fuse_depth"),
        runtime=minutes_for("fuse_depth"),
        gpu=0,
    params:
        method=cfg("mvs.fusion"),
        min_views=cfg("mvs.min_views"),
        n_check=cfg("mvs.n_check"),
        max_reproj_error_px=cfg("mvs.max_reproj_error_px"),
        max_depth_error=cfg("mvs.max_depth_error"),
        max_normal_error_deg=cfg("mvs.max_normal_error_deg"),
        silhouettes=cfg("mvs.silhouettes"),
    message:
        "{wildcards.tree}: fuse the depth maps"
    script:
        "../../scripts/fuse_depth.py"
