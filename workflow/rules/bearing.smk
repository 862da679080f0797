# Bearing wood, by piece of axis and by limb; of trees whose config asks for it.


rule measure_bearing:
    input:
        skeleton="results/{tree}/skeleton.graphml",
        branches="results/{tree}/branches.csv",
        photo_check=photo_only("results/{tree}/photo_check.json"),
        limbs="results/{tree}/limbs.csv",
        traits="results/{tree}/traits.json",
    output:
        pieces=ensure("results/{tree}/bearing.csv", non_empty=True),
        bearing=ensure("results/{tree}/bearing.json", non_empty=True),
    log:
        "logs/measure_bearing/{tree}.log",
    benchmark:
        "benchmarks/measure_bearing/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    resources:
        **resources_for("measure_bearing"),
    params:
        **stage_params("measure_bearing", "bearing/rates.yaml"),
    message:
        "{wildcards.tree}: tell the bearing wood"
    script:
        "../../scripts/measure_bearing.py"
