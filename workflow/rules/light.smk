# Light that a tree receives, by axis and by limb; of trees whose config asks for it.


rule measure_light:
    input:
        skeleton="results/{tree}/skeleton.graphml",
        branches="results/{tree}/branches.csv",
        photo_check=photo_only("results/{tree}/photo_check.json"),
        limbs="results/{tree}/limbs.csv",
    output:
        axes=ensure("results/{tree}/light.csv", non_empty=True),
        light=ensure("results/{tree}/light.json", non_empty=True),
    log:
        "logs/measure_light/{tree}.log",
    benchmark:
        "benchmarks/measure_light/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("measure_light")
    resources:
        **resources_for("measure_light"),
    params:
        **stage_params("measure_light"),
    message:
        "{wildcards.tree}: measure the light"
    script:
        "../../scripts/measure_light.py"
