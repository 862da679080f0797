# The benchmark of skeletons, see docs/lab/skeleton.md. Only `snakemake benchmark_skeleton`,
# `snakemake benchmark_peers` and `snakemake benchmark_trunks` run it.


wildcard_constraints:
    number=r"\d\d+",
    kind="default|paper|peer|pytlidar",
    millimetres=r"\d+",


rule benchmark_skeleton:
    input:
        "results/benchmark/skeleton/table.md",


rule benchmark_peers:
    input:
        scores_of_peers(),


rule benchmark_trunks:
    input:
        "results/benchmark/skeleton/trunks/table.md",


rule measure_skeletons:
    input:
        peer_code=str(SCRIPTS / "lab/run_pc_skeletor.py"),
        pytlidar_code=str(SCRIPTS / "lab/run_pytlidar.py"),
    output:
        scores=ensure(
            "results/benchmark/skeleton/{number}/scores_{kind}.json", non_empty=True
        ),
    log:
        "logs/measure_skeletons/{number}_{kind}.log",
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=60,
    params:
        code=code("lab/measure_skeletons"),
        number=lambda wildcards: int(wildcards.number),
        methods=methods_of_kind,
        peer_python=python_of("peer"),
        pytlidar_python=python_of("pytlidar"),
        seed=SKELETON_BENCHMARK["seed"],
    message:
        "tree {wildcards.number} of the set: skeletons, {wildcards.kind}"
    script:
        "../../../scripts/lab/measure_skeletons.py"


rule report_skeletons:
    input:
        measured=scores_of_skeletons(),
    output:
        table=ensure("results/benchmark/skeleton/table.md", non_empty=True),
    log:
        "logs/report_skeletons.log",
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=30,
    params:
        code=code("lab/report_benchmark"),
        kind="skeletons",
    message:
        "tables of the benchmark of skeletons"
    script:
        "../../../scripts/lab/report_benchmark.py"


rule measure_trunk_ratio:
    output:
        scores=ensure(
            "results/benchmark/skeleton/trunks/{millimetres}/{number}/scores.json",
            non_empty=True,
        ),
    log:
        "logs/measure_trunk_ratio/{millimetres}_{number}.log",
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 4000 * attempt,
        runtime=240,
    params:
        code=code("lab/measure_trunk_ratio"),
        number=lambda wildcards: int(wildcards.number),
        trunk_radius=lambda wildcards: int(wildcards.millimetres) / 1000,
        rules=SKELETON_BENCHMARK["trunk_rules"],
        seed=SKELETON_BENCHMARK["seed"],
    message:
        "tree {wildcards.number} of the set, trunk of {wildcards.millimetres} mm radius"
    script:
        "../../../scripts/lab/measure_trunk_ratio.py"


use rule report_skeletons as report_trunk_ratio with:
    input:
        measured=scores_of_trunks(),
    output:
        table=ensure("results/benchmark/skeleton/trunks/table.md", non_empty=True),
    log:
        "logs/report_trunk_ratio.log",
    params:
        code=code("lab/report_benchmark"),
        kind="trunks",
    message:
        "S-LBC over LBC by trunk radius"
