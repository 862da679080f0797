# Isolated points and sky silhouettes out of the cropped cloud.


rule denoise_cloud:
    input:
        cloud="results/{tree}/cropped.ply",
        poses="results/{tree}/aligned_poses.npz",
        cameras="results/{tree}/sfm/model/cameras.bin",
        photos=photos_of,
        masks="results/{tree}/sky",
        sky_colors="results/{tree}/sky_colors.npz",
        code=code("denoise_cloud"),
    output:
        denoised=ensure("results/{tree}/denoised.ply", non_empty=True),
        report="results/{tree}/denoise.json",
    log:
        "logs/denoise_cloud/{tree}.log",
    benchmark:
        "benchmarks/denoise_cloud/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("denoise_cloud")
    resources:
        mem_mb=mb_for("denoise_cloud"),
        runtime=minutes_for("denoise_cloud"),
        gpu=0,
    params:
        photo_folder=row("photos"),
        use_statistical=cfg("denoise.use_statistical"),
        n_neighbors=cfg("denoise.n_neighbors"),
        std_ratio=cfg("denoise.std_ratio"),
        min_view_ratio=cfg("denoise.min_view_ratio"),
        keep_seen_fraction=cfg("denoise.keep_seen_fraction"),
        use_sky=cfg("denoise.use_sky"),
        sky_color_distance=cfg("denoise.sky_color_distance"),
        same_color_distance=cfg("denoise.same_color_distance"),
        min_non_sky_fraction=cfg("denoise.min_non_sky_fraction"),
        sky_clearance=cfg("denoise.sky_clearance_px"),
        twig_contrast=cfg("denoise.twig_contrast"),
        depth_side=cfg("mvs.max_image_size_px"),
    message:
        "{wildcards.tree}: remove outliers and sky silhouettes"
    script:
        "../../scripts/denoise_cloud.py"
