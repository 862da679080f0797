# Structure from motion in three steps, so that a change of one reruns no more than it must.


# For a scan whose photos are not all plain files of a usable size without masks (docs/photos.md).
rule prepare_photos:
    input:
        captures=of_tree(SCANS.captures),
        user_masks=of_tree(SCANS.masks),
    output:
        photos=directory("results/{tree}/photos"),
        photo_masks=directory("results/{tree}/photo_masks"),
        listing=ensure("results/{tree}/photos.json", non_empty=True),
    log:
        "logs/prepare_photos/{tree}.log",
    benchmark:
        "benchmarks/prepare_photos/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("prepare_photos")
    resources:
        **resources_for("prepare_photos"),
    params:
        **stage_params("prepare_photos"),
        problem=lambda wildcards, input: SCANS.problem(wildcards.tree),
        folder=row("photos"),
        masks=row("masks"),
    message:
        "{wildcards.tree}: make the photos that every stage reads"
    script:
        "../../scripts/prepare_photos.py"


rule extract_features:
    input:
        photos=photos_of,
        photo_masks=branch(row("masks"), then="results/{tree}/photo_masks"),
    output:
        database=ensure("results/{tree}/sfm/features.db", non_empty=True),
        listing=ensure("results/{tree}/sfm/photos.json", non_empty=True),
    log:
        "logs/extract_features/{tree}.log",
    benchmark:
        "benchmarks/extract_features/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("extract_features")
    resources:
        **resources_for("extract_features"),
    params:
        **stage_params("extract_features"),
        problem=lambda wildcards, input: SCANS.problem(wildcards.tree),
        folder=photo_folder,
    message:
        "{wildcards.tree}: extract features of the photos"
    script:
        "../../scripts/extract_features.py"


rule match_features:
    input:
        features="results/{tree}/sfm/features.db",
    output:
        database=ensure("results/{tree}/sfm/database.db", non_empty=True),
    log:
        "logs/match_features/{tree}.log",
    benchmark:
        "benchmarks/match_features/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("match_features")
    resources:
        **resources_for("match_features"),
    params:
        **stage_params("match_features"),
    message:
        "{wildcards.tree}: match the photos"
    script:
        "../../scripts/match_features.py"


rule reconstruct_sparse:
    input:
        database="results/{tree}/sfm/database.db",
        listing="results/{tree}/sfm/photos.json",
        photos=photos_of,
        photo_masks=branch(row("masks"), then="results/{tree}/photo_masks"),
    output:
        cameras=ensure("results/{tree}/sfm/model/cameras.bin", non_empty=True),
        images=ensure("results/{tree}/sfm/model/images.bin", non_empty=True),
        points=ensure("results/{tree}/sfm/model/points3D.bin", non_empty=True),
        frames=ensure("results/{tree}/sfm/model/frames.bin", non_empty=True),
        rigs=ensure("results/{tree}/sfm/model/rigs.bin", non_empty=True),
        report=ensure("results/{tree}/sfm/report.json", non_empty=True),
        poses=ensure("results/{tree}/poses.npz", non_empty=True),
    log:
        "logs/reconstruct_sparse/{tree}.log",
    benchmark:
        "benchmarks/reconstruct_sparse/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("reconstruct_sparse")
    resources:
        **resources_for("reconstruct_sparse"),
    params:
        **stage_params("reconstruct_sparse"),
    message:
        "{wildcards.tree}: reconstruct the camera poses"
    script:
        "../../scripts/reconstruct_sparse.py"
