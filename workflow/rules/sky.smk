# Sky masks of the photos and the sky's dominant colours.


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
        **options("segment_sky"),
        problem=problem_of,
        photo_folder=row("photos"),
    message:
        "{wildcards.tree}: tell sky from everything else in the photos"
    script:
        "../../scripts/segment_sky.py"
