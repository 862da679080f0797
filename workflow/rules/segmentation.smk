# The network that labels the cloud, and the limbs of its trees.


ruleorder: grow_limbs > segment_cloud


rule segment_cloud:
    input:
        cloud="results/{tree}/metric.ply",
        scale=photo_only("results/{tree}/scale.json"),
        align=photo_only("results/{tree}/align.json"),
        metric=photo_only("results/{tree}/metric.json"),
        weights_file=weights_of("segment.weights"),
    output:
        segmented=ensure("results/{tree}/segmented.ply", non_empty=True),
        limbs=ensure("results/{tree}/limbs.npz", non_empty=True),
    log:
        "logs/segment_cloud/{tree}.log",
    benchmark:
        "benchmarks/segment_cloud/{tree}.tsv"
    conda:
        "../../envs/learning.yaml"
    threads: threads_for("segment_cloud")
    resources:
        **resources_for("segment_cloud"),
    params:
        **stage_params("segment_cloud", PROJECT / "resources/weights/dgcnn.pt"),
        is_row=is_of_several,
    message:
        "{wildcards.tree}: label the cloud and grow its limbs"
    script:
        "../../scripts/segment_cloud.py"


# A cloud that came with labels
rule grow_limbs:
    input:
        segmented="results/{tree}/segmented.ply",
    output:
        limbs=ensure("results/{tree}/limbs.npz", non_empty=True),
    log:
        "logs/grow_limbs/{tree}.log",
    benchmark:
        "benchmarks/grow_limbs/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(LABELLED_TREES),
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("grow_limbs")
    resources:
        **resources_for("grow_limbs"),
    params:
        **stage_params("grow_limbs"),
        is_row=is_of_several,
    message:
        "{wildcards.tree}: grow the limbs"
    script:
        "../../scripts/grow_limbs.py"
