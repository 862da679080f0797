# Sky masks of the photos and the sky's dominant colours, and the training of their network.


rule segment_sky:
    input:
        photos=photos_of,
        # Absent weights are the stage's to report, by the name of the key.
        weights_file=lambda wildcards: [
            path
            for path in [
                cfg("sky.weights")(wildcards) or resource("weights/sky_unet.npz")
            ]
            if Path(path).is_file()
        ],
        code=code("segment_sky"),
    output:
        masks=directory("results/{tree}/sky"),
        colors=ensure("results/{tree}/sky_colors.npz", non_empty=True),
    log:
        "logs/segment_sky/{tree}.log",
    benchmark:
        "benchmarks/segment_sky/{tree}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: threads_for("segment_sky")
    resources:
        mem_mb=mb_for("segment_sky"),
        runtime=minutes_for("segment_sky"),
        gpu=0,
    params:
        problem=problem_of,
        photo_folder=row("photos"),
        weights=lambda wildcards: (
            cfg("sky.weights")(wildcards) or resource("weights/sky_unet.npz")
        ),
        working_side_px=cfg("sky.working_side_px"),
        threshold=cfg("sky.threshold"),
        guide_radius_px=cfg("sky.guide_radius_px"),
        guide_epsilon=cfg("sky.guide_epsilon"),
        color_weight=cfg("sky.color_weight"),
        twig_contrast=cfg("sky.twig_contrast"),
        n_color_samples=cfg("sky.n_color_samples"),
        cluster_epsilon=cfg("sky.cluster_epsilon"),
        cluster_min_density=cfg("sky.cluster_min_density"),
        cluster_min_fraction=cfg("sky.cluster_min_fraction"),
        seed=cfg("seed"),
    message:
        "{wildcards.tree}: tell sky from everything else in the photos"
    script:
        "../../scripts/segment_sky.py"


rule train_sky:
    input:
        code=code("train_sky"),
    output:
        weights=ensure("results/training/sky/sky_unet.npz", non_empty=True),
        metrics=ensure("results/training/sky/metrics.json", non_empty=True),
    log:
        "logs/train_sky.log",
    benchmark:
        "benchmarks/train_sky.tsv"
    conda:
        "../../envs/learning.yaml"
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
        "../../scripts/train_sky.py"
