# The benchmark of dense stereo, see docs/lab/dense.md. Only `snakemake benchmark_dense` runs it.


wildcard_constraints:
    scan=any_of(BENCHMARK_FOLDERS),
    cameras="true|sfm",
    size=r"full|[0-9.]+mp",
    backend="|".join(ALL_BACKENDS),


rule benchmark_dense:
    input:
        "results/benchmark/dense/table.md",


rule render_benchmark_scene:
    output:
        rendered="results/benchmark/scenes/{scan}/rendered.json",
    log:
        "logs/render_benchmark_scene/{scan}.log",
    conda:
        "../../../envs/photogrammetry.yaml"
    threads: 8
    resources:
        mem_mb=more_at_each_attempt(4000),
        runtime=240,
    params:
        **stage_params("lab/render_benchmark_scene"),
        preset="{scan}",
    message:
        "{wildcards.scan}: render the scene"
    script:
        "../../../scripts/lab/render_benchmark_scene.py"


rule match_benchmark_photos:
    input:
        photos=benchmark_photo_files,
    output:
        features=temp("results/benchmark/dense/{scan}/features.db"),
        database=ensure("results/benchmark/dense/{scan}/database.db", non_empty=True),
        listing=ensure("results/benchmark/dense/{scan}/photos.json", non_empty=True),
    log:
        "logs/match_benchmark_photos/{scan}.log",
    conda:
        "../../../envs/photogrammetry.yaml"
    threads: 8
    resources:
        mem_mb=more_at_each_attempt(8000),
        runtime=240,
    params:
        **stage_params("lab/match_benchmark_photos"),
        folder=benchmark_photos,
    message:
        "{wildcards.scan}: match the photos"
    script:
        "../../../scripts/lab/match_benchmark_photos.py"


rule mask_benchmark_sky:
    input:
        photos=benchmark_photo_files,
    output:
        masks=directory("results/benchmark/dense/{scan}/sky"),
        colors=ensure("results/benchmark/dense/{scan}/sky_colors.npz", non_empty=True),
    log:
        "logs/mask_benchmark_sky/{scan}.log",
    conda:
        "../../../envs/learning.yaml"
    threads: 8
    resources:
        mem_mb=more_at_each_attempt(6000),
        runtime=120,
    params:
        code=code("segment_sky"),
        photo_folder=benchmark_photos,
        seed=cfg("seed"),
    message:
        "{wildcards.scan}: tell sky from everything else in the photos"
    script:
        "../../../scripts/segment_sky.py"


rule place_benchmark_cameras:
    input:
        database="results/benchmark/dense/{scan}/database.db",
        listing="results/benchmark/dense/{scan}/photos.json",
    output:
        images=ensure(
            "results/benchmark/dense/{scan}/{cameras}/model/images.bin", non_empty=True
        ),
        undistorted=ensure(
            "results/benchmark/dense/{scan}/{cameras}/dense/poses.npz",
            non_empty=True,
        ),
    log:
        "logs/place_benchmark_cameras/{scan}_{cameras}.log",
    conda:
        "../../../envs/photogrammetry.yaml"
    threads: 8
    resources:
        mem_mb=more_at_each_attempt(8000),
        runtime=120,
    params:
        **stage_params("lab/place_benchmark_cameras"),
        cameras="{cameras}",
        folder=benchmark_photos,
        poses=lambda wildcards: f"{benchmark_truth(wildcards)}/poses.npz",
    message:
        "{wildcards.scan}: dense workspace, cameras: {wildcards.cameras}"
    script:
        "../../../scripts/lab/place_benchmark_cameras.py"


rule measure_stereo:
    input:
        undistorted="results/benchmark/dense/{scan}/{cameras}/dense/poses.npz",
        images="results/benchmark/dense/{scan}/{cameras}/model/images.bin",
        sky_masks=benchmark_sky,
    output:
        measurement=ensure(
            "results/benchmark/dense/{scan}/{cameras}/{size}/{backend}/measurement.json",
            non_empty=True,
        ),
        cloud=ensure(
            "results/benchmark/dense/{scan}/{cameras}/{size}/{backend}/cloud.ply",
            non_empty=True,
        ),
    log:
        "logs/measure_stereo/{scan}_{cameras}_{size}_{backend}.log",
    benchmark:
        "benchmarks/measure_stereo/{scan}_{cameras}_{size}_{backend}.tsv"
    conda:
        "../../../envs/photogrammetry.yaml"
    # all cores, so that no other run disturbs the measurement
    threads: lambda wildcards: workflow.cores
    resources:
        mem_mb=more_at_each_attempt(8000),
        runtime=600,
        gpu=lambda wildcards: int(ALL_BACKENDS[wildcards.backend].needs_cuda),
    params:
        **stage_params("lab/measure_stereo"),
        scan="{scan}",
        cameras="{cameras}",
        backend="{backend}",
        megapixels=lambda wildcards: megapixels_of(wildcards.size),
    message:
        "{wildcards.scan}, cameras {wildcards.cameras}, {wildcards.size}: {wildcards.backend}"
    script:
        "../../../scripts/lab/measure_stereo.py"


rule score_surface:
    input:
        cloud="results/benchmark/dense/{scan}/{cameras}/{size}/{backend}/cloud.ply",
        poses="results/benchmark/dense/{scan}/{cameras}/dense/poses.npz",
    output:
        scores=ensure(
            "results/benchmark/dense/{scan}/{cameras}/{size}/{backend}/scores.json",
            non_empty=True,
        ),
        scored=ensure(
            "results/benchmark/dense/{scan}/{cameras}/{size}/{backend}/scored.ply",
            non_empty=True,
        ),
    log:
        "logs/score_surface/{scan}_{cameras}_{size}_{backend}.log",
    conda:
        "../../../envs/photogrammetry.yaml"
    threads: 8
    resources:
        mem_mb=more_at_each_attempt(4000),
        runtime=60,
    params:
        **stage_params("lab/score_surface"),
        truth=benchmark_truth,
        fit=lambda wildcards: "none" if wildcards.cameras == "true" else "surface",
    message:
        "{wildcards.scan}, cameras {wildcards.cameras}, {wildcards.size}: "
        "score {wildcards.backend}"
    script:
        "../../../scripts/lab/score_surface.py"


rule report_benchmark:
    input:
        results=benchmark_result_files(),
    output:
        table=ensure("results/benchmark/dense/table.md", non_empty=True),
    log:
        "logs/report_benchmark.log",
    conda:
        "../../../envs/report.yaml"
    threads: 1
    resources:
        mem_mb=more_at_each_attempt(4000),
        runtime=30,
    params:
        code=code("lab/report_benchmark"),
        measurements=[f"{run}/measurement.json" for run in BENCHMARK_RUNS],
        backends=BENCHMARK["backends"],
    message:
        "tables and figures of the benchmark of dense stereo"
    script:
        "../../../scripts/lab/report_benchmark.py"
