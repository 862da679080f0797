# Ready clouds: a labelled one skips the network, and only these rules know which scan is which.


ruleorder: import_cloud > scale_cloud
ruleorder: import_segmented_cloud > segment_cloud


rule import_cloud:
    input:
        source=of_tree(SCANS.cloud),
    output:
        imported=ensure("results/{tree}/metric.ply", non_empty=True),
    log:
        "logs/import_cloud/{tree}.log",
    benchmark:
        "benchmarks/import_cloud/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(UNLABELLED_TREES),
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("import_cloud")
    resources:
        **resources_for("import_cloud"),
    params:
        **stage_params("import_cloud"),
        cloud=row("cloud"),
        unit=row("cloud_unit"),
        up=row("cloud_up"),
        scale=row("scale"),
    message:
        "{wildcards.tree}: import the ready cloud"
    script:
        "../../scripts/import_cloud.py"


use rule import_cloud as import_segmented_cloud with:
    output:
        imported=ensure("results/{tree}/segmented.ply", non_empty=True),
    log:
        "logs/import_segmented_cloud/{tree}.log",
    benchmark:
        "benchmarks/import_segmented_cloud/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(LABELLED_TREES),
    message:
        "{wildcards.tree}: import the labelled cloud"
