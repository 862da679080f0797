# From the labelled cloud to the skeleton and its graphs.


rule contract_cloud:
    input:
        segmented="results/{tree}/segmented.ply",
        limbs="results/{tree}/limbs.npz",
        # Where the tree stands: a tree of a scan of several has a file of its own
        metric=lambda wildcards: (
            photo_only("results/{tree}/metric.json")(wildcards)
            if wildcards.tree in TREES
            else "results/{tree}/tree.json"
        ),
        aligned=photo_only("results/{scan}/aligned.ply"),
        cropped=photo_only("results/{scan}/cropped.ply"),
        denoised_by=photo_only("results/{scan}/denoise.npz"),
    output:
        contracted=ensure("results/{tree}/contracted.ply", non_empty=True),
        report="results/{tree}/contract.json",
        target="results/{tree}/target.json",
        removed="results/{tree}/removed.ply",
    log:
        "logs/contract_cloud/{tree}.log",
    benchmark:
        "benchmarks/contract_cloud/{tree}.tsv"
    wildcard_constraints:
        tree=none_of(BATCH.places),
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("contract_cloud")
    resources:
        **resources_for("contract_cloud"),
    params:
        **stage_params("contract_cloud"),
    message:
        "{wildcards.tree}: contract the target's wood to its skeleton points"
    script:
        "../../scripts/contract_cloud.py"


rule extract_graph:
    input:
        contracted="results/{tree}/contracted.ply",
        contract_report="results/{tree}/contract.json",
        limbs="results/{tree}/limbs.npz",
        segmented="results/{tree}/segmented.ply",
        cameras=photo_only("results/{scan}/dense/poses.npz"),
        metric_poses=photo_only("results/{scan}/metric_poses.npz"),
        evidence=photo_only("results/{scan}/evidence"),
        depth=photo_only("results/{scan}/depth"),
    output:
        skeleton_graph=ensure("results/{tree}/skeleton.graphml", non_empty=True),
        skeleton_ply=ensure("results/{tree}/skeleton.ply", non_empty=True),
        skeleton_swc=ensure("results/{tree}/skeleton.swc", non_empty=True),
        topology=ensure("results/{tree}/topology.graphml", non_empty=True),
        report="results/{tree}/graph.json",
    log:
        "logs/extract_graph/{tree}.log",
    benchmark:
        "benchmarks/extract_graph/{tree}.tsv"
    wildcard_constraints:
        tree=none_of([*EDITED_TREES, *BATCH.places]),
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("extract_graph")
    resources:
        **resources_for("extract_graph"),
    params:
        **stage_params("extract_graph"),
    message:
        "{wildcards.tree}: connect the skeleton and measure its radii"
    script:
        "../../scripts/extract_graph.py"


# A tree with hand corrections: the solver's skeleton is kept, so that an edit costs no new solution.
use rule extract_graph as solve_graph with:
    output:
        skeleton_graph=ensure("results/{tree}/solved.graphml", non_empty=True),
        report="results/{tree}/graph.json",
    log:
        "logs/solve_graph/{tree}.log",
    benchmark:
        "benchmarks/solve_graph/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(EDITED_TREES),


rule edit_graph:
    input:
        solved="results/{tree}/solved.graphml",
        edits=of_tree(BATCH.edits_of),
    output:
        skeleton_graph=ensure("results/{tree}/skeleton.graphml", non_empty=True),
        skeleton_ply=ensure("results/{tree}/skeleton.ply", non_empty=True),
        skeleton_swc=ensure("results/{tree}/skeleton.swc", non_empty=True),
        topology=ensure("results/{tree}/topology.graphml", non_empty=True),
        report="results/{tree}/edits.json",
    log:
        "logs/edit_graph/{tree}.log",
    benchmark:
        "benchmarks/edit_graph/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(EDITED_TREES),
    conda:
        "../../envs/pointcloud.yaml"
    threads: 1
    resources:
        **resources_for("extract_graph"),
    params:
        code=code("edit_graph"),
    message:
        "{wildcards.tree}: apply the hand corrections to the skeleton"
    script:
        "../../scripts/edit_graph.py"
