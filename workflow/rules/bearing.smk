# Bearing wood, by piece of axis and by limb, and buds; of trees whose config asks for it.


rule measure_bearing:
    input:
        skeleton="results/{tree}/skeleton.graphml",
        branches="results/{tree}/branches.csv",
        photo_check=photo_only("results/{tree}/photo_check.json"),
        limbs="results/{tree}/limbs.csv",
        traits="results/{tree}/traits.json",
        photos=photos_of,
        model=photo_only("results/{scan}/sfm/model/images.bin"),
        cameras=photo_only("results/{scan}/dense/poses.npz"),
        metric_poses=photo_only("results/{scan}/metric_poses.npz"),
        evidence=photo_only("results/{scan}/evidence"),
    output:
        pieces=ensure("results/{tree}/bearing.csv", non_empty=True),
        buds=ensure("results/{tree}/buds.csv", non_empty=True),
        bearing=ensure("results/{tree}/bearing.json", non_empty=True),
    log:
        "logs/measure_bearing/{tree}.log",
    benchmark:
        "benchmarks/measure_bearing/{tree}.tsv"
    conda:
        "../../envs/photogrammetry.yaml"
    resources:
        **resources_for("measure_bearing"),
    params:
        **stage_params("measure_bearing", "bearing/rates.yaml"),
    message:
        "{wildcards.tree}: tell the bearing wood and its buds"
    script:
        "../../scripts/measure_bearing.py"
