# Cuts that bring a tree to a pruning target; of trees whose config names a preset.


rule propose_pruning:
    input:
        skeleton="results/{tree}/skeleton.graphml",
        branches="results/{tree}/branches.csv",
        photo_check=photo_only("results/{tree}/photo_check.json"),
        limbs="results/{tree}/limbs.csv",
        traits="results/{tree}/traits.json",
        light=branch(cfg("light.enabled"), then="results/{tree}/light.json"),
    output:
        cuts=ensure("results/{tree}/pruning.csv", non_empty=True),
        pruning=ensure("results/{tree}/pruning.json", non_empty=True),
    log:
        "logs/propose_pruning/{tree}.log",
    benchmark:
        "benchmarks/propose_pruning/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: 1
    resources:
        **resources_for("propose_pruning"),
    params:
        **stage_params("propose_pruning", "pruning/presets.yaml", "bearing/rates.yaml"),
    message:
        "{wildcards.tree}: propose the pruning"
    script:
        "../../scripts/propose_pruning.py"
