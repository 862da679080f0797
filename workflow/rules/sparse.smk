# Structure from motion in three steps, so that a change of one reruns no more than it must.


rule extract_features:
    input:
        photos=photos_of,
        code=code("extract_features"),
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
        mem_mb=mb_for("extract_features"),
        runtime=minutes_for("extract_features"),
        gpu=0,
    params:
        problem=problem_of,
        folder=row("photos"),
        camera_mode=cfg("sfm.camera_mode"),
        camera_model=cfg("sfm.camera_model"),
        max_features=cfg("sfm.max_features"),
        max_image_size_px=cfg("sfm.max_image_size_px"),
        skip_unreadable=cfg("sfm.skip_unreadable"),
        seed=cfg("seed"),
    message:
        "{wildcards.tree}: extract features of the photos"
    script:
        "../../scripts/extract_features.py"


rule match_features:
    input:
        features="results/{tree}/sfm/features.db",
        code=code("match_features"),
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
        mem_mb=mb_for("match_features"),
        runtime=minutes_for("match_features"),
        gpu=0,
    params:
        pairing=cfg("sfm.pairing"),
        exhaustive_max_photos=cfg("sfm.exhaustive_max_photos"),
        retrieval_neighbors=cfg("sfm.retrieval_neighbors"),
        sequential_overlap=cfg("sfm.sequential_overlap"),
        vocab_tree_path=cfg("sfm.vocab_tree_path"),
        max_ratio=cfg("sfm.max_match_ratio"),
        max_error_px=cfg("sfm.max_epipolar_error_px"),
        min_inliers=cfg("sfm.min_inliers"),
        guided=cfg("sfm.guided_matching"),
        seed=cfg("seed"),
    message:
        "{wildcards.tree}: match the photos"
    script:
        "../../scripts/match_features.py"


rule reconstruct_sparse:
    input:
        database="results/{tree}/sfm/database.db",
        listing="results/{tree}/sfm/photos.json",
        photos=photos_of,
        code=code("reconstruct_sparse"),
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
        mem_mb=mb_for("reconstruct_sparse"),
        runtime=minutes_for("reconstruct_sparse"),
        gpu=0,
    params:
        mapper=cfg("sfm.mapper"),
        min_registered_fraction=cfg("sfm.min_registered_fraction"),
        wanted_fraction=cfg("sfm.wanted_registered_fraction"),
        wanted_agreement=cfg("sfm.wanted_pair_agreement"),
        max_attempts=cfg("sfm.max_attempts"),
        max_ratio=cfg("sfm.max_match_ratio"),
        max_error_px=cfg("sfm.max_epipolar_error_px"),
        min_inliers=cfg("sfm.min_inliers"),
        seed=cfg("seed"),
    message:
        "{wildcards.tree}: reconstruct the camera poses"
    script:
        "../../scripts/reconstruct_sparse.py"
