# The photos judge the skeleton: what is not there, what is missing, how thick it is.


rule check_photos:
    input:
        skeleton="results/{tree}/skeleton.graphml",
        graph_report="results/{tree}/graph.json",
        segmented=file_of("results/{scan}/segmented.ply"),
        target="results/{tree}/target.json",
        cloud=file_of("results/{scan}/cloud.ply"),
        photos=photos_of,
        model=file_of("results/{scan}/sfm/model/images.bin"),
        cameras=file_of("results/{scan}/dense/poses.npz"),
        metric_poses=file_of("results/{scan}/metric_poses.npz"),
        evidence=file_of("results/{scan}/evidence"),
        depth=file_of("results/{scan}/depth"),
    output:
        report=ensure("results/{tree}/photo_check.json", non_empty=True),
        worst="results/{tree}/photo_check/worst.jpg",
        best="results/{tree}/photo_check/best.jpg",
    log:
        "logs/check_photos/{tree}.log",
    benchmark:
        "benchmarks/check_photos/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    threads: threads_for("check_photos")
    resources:
        **resources_for("check_photos"),
    params:
        **stage_params("check_photos"),
    message:
        "{wildcards.tree}: let the photos judge the skeleton"
    script:
        "../../scripts/check_photos.py"
