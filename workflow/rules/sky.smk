# Sky masks of the photos and the sky's dominant colours.


rule segment_sky:
    input:
        photos=photos_of,
        photo_masks=branch(row("masks"), then="results/{tree}/photo_masks"),
        weights_file=weights_of("sky.weights"),
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
        **resources_for("segment_sky"),
    params:
        **stage_params("segment_sky", PROJECT / "resources/weights/sky_unet.npz"),
        problem=lambda wildcards, input: SCANS.problem(wildcards.tree),
        photo_folder=photo_folder,
    message:
        "{wildcards.tree}: tell sky from everything else in the photos"
    script:
        "../../scripts/segment_sky.py"
