# Training of the two networks, on photos with sky masks and on generated scenes.


rule train_sky:
    input:
        code=code("lab/train_sky"),
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
        mem_mb=more_at_each_attempt(6000),
        runtime=720,
        gpu=0,
    params:
        folders=cfg("train_sky.folders"),
        holdout=cfg("train_sky.holdout"),
        exclude=cfg("train_sky.exclude"),
        validation_fraction=cfg("train_sky.validation_fraction"),
        epochs=cfg("train_sky.epochs"),
        batch_size=cfg("train_sky.batch_size"),
        learning_rate=cfg("train_sky.learning_rate"),
        learning_rate_decay=cfg("train_sky.learning_rate_decay"),
        schedule=cfg("train_sky.schedule"),
        weight_average=cfg("train_sky.weight_average"),
        weight_decay=cfg("train_sky.weight_decay"),
        source_power=cfg("train_sky.source_power"),
        use_bfloat16=cfg("train_sky.use_bfloat16"),
        time_limit_min=cfg("train_sky.time_limit_min"),
        image_size=cfg("train_sky.image_size_px"),
        samples_per_epoch=cfg("train_sky.samples_per_epoch"),
        max_side_px=cfg("train_sky.max_side_px"),
        elastic_px=cfg("train_sky.elastic_px"),
        scale_range=cfg("train_sky.scale_range"),
        branch_fraction=cfg("train_sky.branch_fraction"),
        exchange_fraction=cfg("train_sky.exchange_fraction"),
        seed=cfg("seed"),
    message:
        "train the sky network on photos with sky masks"
    script:
        "../../../scripts/lab/train_sky.py"


rule train_segmentation:
    input:
        code=code("lab/train_segmentation"),
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
        "../../../scripts/lab/train_segmentation.py"
