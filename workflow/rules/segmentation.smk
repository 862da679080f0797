# The network that labels the cloud, and its training on generated scenes.


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


rule train_segmentation:
    input:
        code=code("train_segmentation"),
    output:
        weights=ensure("results/segmentation/dgcnn.pt", non_empty=True),
        metrics=ensure("results/segmentation/dgcnn.json", non_empty=True),
    log:
        "logs/train_segmentation.log",
    benchmark:
        "benchmarks/train_segmentation.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: 2
    resources:
        mem_mb=more_at_each_attempt(8000),
        runtime=720,
        gpu=0,
    params:
        # The scenes and the checkpoint outlive a killed run here, so they are no outputs.
        workspace="results/segmentation/training",
        n_scenes=cfg("train_segment.n_scenes"),
        n_held_out=cfg("train_segment.n_held_out"),
        scene_points=cfg("train_segment.scene_points"),
        epochs=cfg("train_segment.epochs"),
        batch_spheres=cfg("train_segment.batch_spheres"),
        spheres_per_cloud=cfg("train_segment.spheres_per_cloud"),
        learning_rate=cfg("train_segment.learning_rate"),
        final_learning_rate=cfg("train_segment.final_learning_rate"),
        color_dropout=cfg("train_segment.color_dropout"),
        voxel_size_m=cfg("train_segment.voxel_size_m"),
        sphere_radius_m=cfg("train_segment.sphere_radius_m"),
        sphere_points=cfg("train_segment.sphere_points"),
        reference_height_m=cfg("train_segment.reference_height_m"),
        width=cfg("train_segment.width"),
        embedding=cfg("train_segment.embedding"),
        k=cfg("train_segment.k"),
        minutes=cfg("train_segment.minutes"),
        start=cfg("train_segment.start"),
        seed=cfg("seed"),
    message:
        "train the point cloud network on generated scenes"
    script:
        "../../scripts/train_segmentation.py"
