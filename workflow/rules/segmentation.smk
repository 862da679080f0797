# The network that labels the cloud.


rule segment_cloud:
    input:
        cloud="results/{tree}/metric.ply",
        # Absent weights are the stage's to report, by the name of the key.
        weights_file=lambda wildcards: [
            path
            for path in [
                cfg("segment.weights")(wildcards) or resource("weights/dgcnn.pt")
            ]
            if Path(path).is_file()
        ],
        code=code("segment_cloud"),
    output:
        segmented=ensure("results/{tree}/segmented.ply", non_empty=True),
    log:
        "logs/segment_cloud/{tree}.log",
    benchmark:
        "benchmarks/segment_cloud/{tree}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: threads_for("segment_cloud")
    resources:
        mem_mb=mb_for("segment_cloud"),
        runtime=minutes_for("segment_cloud"),
        gpu=0,
    params:
        weights=lambda wildcards: (
            cfg("segment.weights")(wildcards) or resource("weights/dgcnn.pt")
        ),
        voxel_size_m=cfg("segment.voxel_size_m"),
        max_points=cfg("segment.max_points"),
        reference_height_m=cfg("segment.reference_height_m"),
        sphere_radius_m=cfg("segment.sphere_radius_m"),
        sphere_points=cfg("segment.sphere_points"),
        min_visits=cfg("segment.min_visits"),
        batch_spheres=cfg("segment.batch_spheres"),
        smooth_k=cfg("segment.smooth_k"),
        trunk_gap_m=cfg("segment.trunk_gap_m"),
        trunk_base_height_m=cfg("segment.trunk_base_height_m"),
        split_post=cfg("segment.split_post"),
        post_min_height_m=cfg("segment.post_min_height_m"),
        post_max_tilt_deg=cfg("segment.post_max_tilt_deg"),
        trace_stems=cfg("segment.trace_stems"),
        stem_gap_m=cfg("segment.stem_gap_m"),
        seed=cfg("seed"),
    message:
        "{wildcards.tree}: label the cloud"
    script:
        "../../scripts/segment_cloud.py"
