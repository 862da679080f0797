# The synthetic orchard, see docs/lab/orchard.md. Only `snakemake orchard` and `orchard_skeletons` run it.

import json

ORCHARD = SETTINGS["orchard"]
ORCHARD_SEEDS = range(ORCHARD["seed"], ORCHARD["seed"] + ORCHARD["n_scenes"])
ORCHARD_FILES = ["as_seen.ply", "truth/scene.json"]
if ORCHARD["render"]:
    ORCHARD_FILES.append("rendered.json")


wildcard_constraints:
    scene_seed="[0-9]+",


rule orchard:
    input:
        expand(
            "results/orchard/scenes/{scene_seed}/{file}",
            scene_seed=ORCHARD_SEEDS,
            file=ORCHARD_FILES,
        ),


rule orchard_skeletons:
    input:
        "results/orchard/skeletons/index.json",


rule make_orchard_scene:
    output:
        as_seen=ensure(
            "results/orchard/scenes/{scene_seed}/as_seen.ply", non_empty=True
        ),
        truth=ensure(
            multiext(
                "results/orchard/scenes/{scene_seed}/truth/",
                *(
                    "poses.npz",
                    "skeleton.csv",
                    "cloud.ply",
                    "traits.json",
                    "scene.json",
                ),
            ),
            non_empty=True,
        ),
    log:
        "logs/make_orchard_scene/{scene_seed}.log",
    benchmark:
        "benchmarks/make_orchard_scene/{scene_seed}.tsv"
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=20,
    params:
        **stage_params("lab/make_orchard_scene"),
        seed=lambda wildcards: int(wildcards.scene_seed),
        chosen=lambda wildcards: json.dumps(ORCHARD["chosen"], sort_keys=True),
    message:
        "orchard: scene {wildcards.scene_seed}"
    script:
        "../../../scripts/lab/make_orchard_scene.py"


rule render_orchard_scene:
    input:
        scene="results/orchard/scenes/{scene_seed}/truth/scene.json",
        poses="results/orchard/scenes/{scene_seed}/truth/poses.npz",
    output:
        rendered="results/orchard/scenes/{scene_seed}/rendered.json",
    log:
        "logs/render_orchard_scene/{scene_seed}.log",
    benchmark:
        "benchmarks/render_orchard_scene/{scene_seed}.tsv"
    conda:
        "../../../envs/photogrammetry.yaml"
    threads: 8
    resources:
        mem_mb=lambda wildcards, attempt: 4000 * attempt,
        runtime=240,
    params:
        **stage_params("lab/render_orchard_scene"),
        seed=lambda wildcards: int(wildcards.scene_seed),
        chosen=lambda wildcards: json.dumps(ORCHARD["chosen"], sort_keys=True),
    message:
        "orchard: render scene {wildcards.scene_seed}"
    script:
        "../../../scripts/lab/render_orchard_scene.py"


rule make_skeleton_set:
    output:
        index=ensure("results/orchard/skeletons/index.json", non_empty=True),
    log:
        "logs/make_skeleton_set.log",
    benchmark:
        "benchmarks/make_skeleton_set.tsv"
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=60,
    params:
        code=code("lab/make_skeleton_set"),
        seed=ORCHARD["seed"],
        n_trees=ORCHARD["skeleton_trees"],
    message:
        "orchard: the paper's set of trees with true skeletons"
    script:
        "../../../scripts/lab/make_skeleton_set.py"
