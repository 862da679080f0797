# The report of a tree and the table of the batch.


rule report_tree:
    input:
        traits="results/{tree}/traits.json",
        branches="results/{tree}/branches.csv",
        limbs="results/{tree}/limbs.csv",
        skeleton="results/{tree}/skeleton.graphml",
        segmented="results/{tree}/segmented.ply",
        contracted="results/{tree}/contracted.ply",
        contract_report="results/{tree}/contract.json",
        removed="results/{tree}/removed.ply",
        target="results/{tree}/target.json",
        sparse=photo_only("results/{scan}/sfm/report.json"),
        align_report=photo_only("results/{scan}/align.json"),
        crop_report=photo_only("results/{scan}/crop.json"),
        denoise_report=photo_only("results/{scan}/denoise.json"),
        scale=photo_only("results/{scan}/scale.json"),
        poses=photo_only("results/{scan}/poses.npz"),
        cameras=photo_only("results/{scan}/sfm/model/cameras.bin"),
        metric_poses=photo_only("results/{scan}/metric_poses.npz"),
        aligned=photo_only("results/{scan}/aligned.ply"),
        aligned_poses=photo_only("results/{scan}/aligned_poses.npz"),
        cropped=photo_only("results/{scan}/cropped.ply"),
        denoised_by=photo_only("results/{scan}/denoise.npz"),
        sky_masks=photo_only("results/{scan}/sky"),
        depth=photo_only("results/{scan}/depth"),
        coverage=photo_only("results/{scan}/dense/coverage.json"),
        photo_check=photo_only("results/{tree}/photo_check.json"),
        worst_photo=photo_only("results/{tree}/photo_check/worst.jpg"),
        best_photo=photo_only("results/{tree}/photo_check/best.jpg"),
        light=part_of("light", "json"),
        light_axes=part_of("light", "csv"),
        bearing=part_of("bearing", "json"),
        bearing_pieces=part_of("bearing", "csv"),
        pruning=part_of("pruning", "json"),
        cuts=part_of("pruning", "csv"),
        measures=part_of("measures", "json"),
        photos=photos_of,
        edits=branch(of_tree(EDITED_TREES.__contains__), then=of_tree(BATCH.edits_of)),
    output:
        report=report(
            ensure("results/{tree}/report.html", non_empty=True),
            caption="../report/tree.rst",
            category="Trees",
            labels={"tree": "{tree}", "what": "report"},
        ),
        cloud_figure=figure("results/{tree}/figures/cloud.png", "cloud"),
        label_figure=figure("results/{tree}/figures/labels.png", "classes"),
        skeleton_figure=figure("results/{tree}/figures/skeleton.png", "skeleton"),
        topology_figure=figure("results/{tree}/figures/topology.png", "topology"),
        trunk_figure=figure("results/{tree}/figures/trunk.png", "trunk sections"),
        thumbnail_figure="results/{tree}/figures/thumbnail.png",
    log:
        "logs/report_tree/{tree}.log",
    benchmark:
        "benchmarks/report_tree/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(LACKING) if ONLY_FINISHED else TREE_PATTERN,
    priority: 1 if LACKING else 0
    conda:
        "../../envs/report.yaml"
    threads: threads_for("report_tree")
    resources:
        **resources_for("report_tree"),
    params:
        **stage_params(
            "report_tree",
            "report/report.html.j2",
            "report/viewer.html.j2",
            "report/viewer.css",
            "report/accuracy.html.j2",
            "report/bland_altman.html.j2",
            "report/scaffold.*",
            "report/style.css",
            "report/tabs.js",
            "report/pruning.js",
            "report/copy.js",
            "report/units.js",
            "report/viewer_js/*.js",
        ),
        tree=row("tree"),
        date=row("date"),
        series=row("series"),
        lacking=of_tree(lambda tree: failures_told(tree, LACKING.get(tree, ()))),
    message:
        "{wildcards.tree}: write the report"
    script:
        "../../scripts/report_tree.py"


rule summarise_batch:
    input:
        of_each_tree(file_of("results/{tree}/traits.json")),
        of_each_tree(file_of("results/{tree}/report.html")),
        of_each_tree(part_of("measures", "json")),
        # It links them; of a run with failures those that could be made first
        []
        if ONLY_FINISHED
        else expand("results/series/{series}/report.html", series=SERIES),
    output:
        table=report(
            ensure("results/traits.csv", non_empty=True),
            caption="../report/traits.rst",
            category="Batch",
            labels={"what": "traits"},
        ),
        page=report(
            ensure("results/summary.html", non_empty=True),
            caption="../report/summary.rst",
            category="Batch",
            labels={"what": "summary"},
        ),
        measures="results/measures.csv",
        accuracy="results/accuracy.csv",
        dictionary="results/datapackage.json",
    log:
        "logs/summarise_batch.log",
    benchmark:
        "benchmarks/summarise_batch.tsv"
    conda:
        "../../envs/report.yaml"
    # All, so that it waits for pages without what failed, which it links
    threads: workflow.cores if LACKING else 1
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
        runtime=10,
    params:
        code=code(
            "summarise_batch",
            "batch/tables.yaml",
            "report/summary.*",
            "report/accuracy.html.j2",
            "report/bland_altman.html.j2",
            "report/style.css",
            "report/copy.js",
        ),
        trees=lambda wildcards: [row.tree for row in known_rows()],
        dates=lambda wildcards: [row.date for row in known_rows()],
        series=lambda wildcards: [row.series for row in known_rows()],
        parts=lambda wildcards: [
            " ".join(BATCH.parts_of(row.tree)) for row in known_rows()
        ],
        lacking=lambda wildcards: [
            " ".join(LACKING.get(row.tree, ())) for row in known_rows()
        ],
    message:
        "Summarise the batch"
    script:
        "../../scripts/summarise_batch.py"
