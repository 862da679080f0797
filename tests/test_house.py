"""Product below laboratory, rooms in layers, no circle of imports, and what each rule watches."""

import ast
import re
from pathlib import Path

import count_numbers
import pytest
import yaml

from cherrypicker.batch.watched_modules import imported_modules
from cherrypicker.files import imports_of as watched_imports
from cherrypicker.report.tree import FILES

PRODUCT, LABORATORY = "cherrypicker", "cherrypicker_lab"
VOCABULARY = [
    *("errors", "classes", "units", "files", "ply", "pointcloud", "poses", "photos", "lens"),
    *("progress", "compiled", "runner"),
]
# From the bottom up: a room imports itself and what stands before it.
LAYERS = [
    *VOCABULARY,
    *("geometry", "intake", "placement", "sky", "sfm", "mvs", "evidence", "denoising", "markers"),
    *("capture", "skeleton"),
    "wood",
    "limbs",
    *("segmentation", "contraction", "graph", "traits", "formats", "series", "photo_check"),
    *("light", "bearing", "pruning"),
    "accuracy",
    *("report", "batch", "command", "api"),
]
LAB_LAYERS = [
    *(
        "tables",
        "orchard",
        "skeletons",
        "evaluation",
        "dense",
        "traits",
        "series",
        "bearing",
        "training",
    ),
    *("truth_swaps", "error_budget", "spoilt_skeletons", "photo_verdicts"),
    "up_direction",
    *("published", "written_pages"),
]
STAGES = [
    "prepare_photos",
    *("extract_features", "match_features", "reconstruct_sparse", "undistort_photos"),
    *("estimate_depth", "fuse_depth", "align_cloud", "crop_roi", "segment_sky", "denoise_cloud"),
    *("estimate_scale", "scale_cloud", "segment_cloud", "contract_cloud", "extract_graph"),
    *("gather_evidence", "grow_limbs"),
    *("edit_graph", "check_photos", "measure_traits", "measure_light", "measure_bearing"),
    *("propose_pruning", "report_tree", "summarise_batch"),
    *("compare_series", "import_cloud", "compare_measures", "find_trees", "split_scan"),
]


PAGES = {"report_tree", "summarise_batch", "compare_series"}


@pytest.fixture(scope="module")
def scripts(project):
    return project / "scripts"


@pytest.fixture(scope="module")
def imports(scripts):
    """Module name to the names of the modules of ours that it imports, ``__init__`` as ``room``."""
    paths = {
        _name(path, scripts): path
        for package in (PRODUCT, LABORATORY)
        for path in (scripts / package).rglob("*.py")
    }
    return {name: _imports_of(path, paths) for name, path in paths.items()}


def _name(path, scripts):
    parts = path.relative_to(scripts).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _imports_of(path, names):
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            found.update(members & names.keys())
            if members - names.keys():
                found.add(node.module)
    return found & names.keys()


def _room(name):
    return name.split(".")[1]


def test_the_watched_modules_are_those_that_the_syntax_imports(scripts, imports):
    """They are found in the text, which is faster."""
    for path in scripts.rglob("*.py"):
        watched = {_name(file, scripts) for file in watched_imports(path, scripts)}
        assert _imports_of(path, imports) - {_name(path, scripts)} <= watched, path


def test_the_product_never_imports_the_laboratory(imports):
    upward = {
        (name, target)
        for name, targets in imports.items()
        for target in targets
        if name.split(".")[0] == PRODUCT and target.split(".")[0] == LABORATORY
    }
    assert upward == set()


def test_no_stage_reaches_the_laboratory(scripts):
    for script in sorted(scripts.glob("*.py")):
        reached = imported_modules(script, scripts)
        packages = {Path(file).relative_to(scripts.resolve()).parts[0] for file in reached}
        assert packages <= {PRODUCT}, script.name


@pytest.mark.parametrize("package, layers", [(PRODUCT, LAYERS), (LABORATORY, LAB_LAYERS)])
def test_no_import_runs_upward(imports, package, layers):
    upward = []
    for name, targets in imports.items():
        if not name.startswith(f"{package}."):
            continue
        for target in targets:
            is_own = target.startswith(f"{package}.")
            if is_own and layers.index(_room(target)) > layers.index(_room(name)):
                upward.append(f"{name} -> {target}")
    assert upward == []


def test_no_circle(imports):
    open_, done = [], set()

    def visit(name):
        assert name not in open_, " -> ".join([*open_[open_.index(name) :], name])
        if name in done:
            return
        open_.append(name)
        for target in sorted(imports[name]):
            visit(target)
        done.add(open_.pop())

    for name in sorted(imports):
        visit(name)


def test_the_top_holds_the_vocabulary_alone(scripts):
    top = {path.stem for path in (scripts / PRODUCT).glob("*.py")}
    assert top == {"__init__", "api", *VOCABULARY}
    assert len(top) <= 14


def test_the_stages_stand_at_the_top(scripts):
    assert {path.stem for path in scripts.glob("*.py")} == {*STAGES, "forecast"}


def _watching(scripts, module):
    """Stages whose rules watch a module of the product."""
    file = scripts / PRODUCT / module
    assert file.is_file(), module
    return {
        stage for stage in STAGES if str(file) in imported_modules(scripts / f"{stage}.py", scripts)
    }


@pytest.mark.parametrize("module", ["style", "figures", "raster", "viewer"])
def test_the_colours_of_the_report_rerun_the_report_alone(scripts, module):
    assert _watching(scripts, f"report/{module}.py") == {"report_tree"}


def test_the_style_of_the_pages_reruns_the_pages_alone(scripts):
    assert _watching(scripts, "report/text.py") == PAGES


def test_no_module_of_the_report_is_watched_by_another_stage(scripts):
    for path in sorted((scripts / PRODUCT / "report").glob("[!_]*.py")):
        assert _watching(scripts, f"report/{path.name}") <= PAGES


def test_a_radius_of_the_graph_does_not_relabel_clouds(scripts):
    assert _watching(scripts, "graph/extract.py") == {"extract_graph"}
    watched = imported_modules(scripts / "segment_cloud.py", scripts)
    rooms = ("graph", "contraction", "traits", "report")
    assert not [file for file in watched if f"/{PRODUCT}/" in file and file.split("/")[-2] in rooms]


def test_who_reads_skeletons_does_not_watch_what_makes_them(scripts):
    watched = imported_modules(scripts / "edit_graph.py", scripts)
    assert not [file for file in watched if "/graph/" in file or "/contraction/" in file]


def test_the_page_of_the_architecture_names_files_that_exist(project):
    page = (project / "docs/architecture.md").read_text(encoding="utf-8")
    roots = [project, project / "scripts", project / "scripts" / PRODUCT]
    roots += [project / "scripts" / LABORATORY / "training/segmentation"]
    named = set(re.findall(r"`([\w/]+(?:\.py|\.yaml|/))", page))
    assert len(named) > 50
    assert not [name for name in named if not any((root / name).exists() for root in roots)]


def test_every_compiled_function_is_cached_where_the_others_are(scripts):
    for path in (scripts / PRODUCT).rglob("*.py"):
        if path.name != "compiled.py":
            assert "njit" not in path.read_text(encoding="utf-8"), f"{path}: take `compiled`"


def test_no_rule_file_defines_a_name_of_another(project):
    """All rule files share one namespace: the later definition would win in silence."""
    places = {}
    for path in sorted((project / "workflow").rglob("*.smk")):
        text = path.read_text(encoding="utf-8")
        for name in re.findall(r"^(?:def (\w+)\(|(\w+) = )", text, re.MULTILINE):
            places.setdefault("".join(name), set()).add(path.name)
    assert len(places) > 20
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_what_a_rule_watches_beside_modules_is_there(project, scripts):
    rules = "".join(path.read_text() for path in (project / "workflow/rules").rglob("*.smk"))
    watched = re.findall(r'(?:code|stage_params)\(\s*"[\w/]+",((?:[^()]|\([^()]*\))*)\)', rules)
    names = [name for call in watched for name in re.findall(r'"([^"]+)"', call)]
    assert len(names) > 10
    for name in names:
        root = project if name.startswith("resources/") else scripts / PRODUCT
        assert list(root.glob(name)), name


def test_a_page_is_handed_every_file_that_it_shows(project):
    rules = (project / "workflow/rules/report.smk").read_text()
    inputs = re.search(r"^rule report_tree:\n    input:\n((?: {8}.*\n)+)", rules, re.M)[1]
    assert set(FILES) <= set(re.findall(r"^ {8}(\w+)=", inputs, re.M))


def test_an_edit_of_the_contraction_graph_or_traits_relabels_nothing(scripts):
    later = {"contraction", "graph", "traits", "photo_check"}
    for stage in ("segment_cloud", "grow_limbs"):
        reached = imported_modules(scripts / f"{stage}.py", scripts)
        rooms = {Path(file).relative_to(scripts.resolve()).parts[1] for file in reached}
        assert rooms and not rooms & later, stage


MOST_NUMBERS, MOST_GUESSES, MOST_KEYS = 576, 77, 90


def test_named_numbers_only_fall():
    """Lower a limit with the count; what needs a new number takes an old one out."""
    numbers, guesses = count_numbers.count()
    assert numbers.total() <= MOST_NUMBERS
    assert guesses.total() <= MOST_GUESSES


def test_config_keys_only_fall(project):
    """Of the product; the laboratory's stand in a schema of their own."""

    def n_keys(keys):
        return sum(
            n_keys(each["properties"]) if "properties" in each else 1 for each in keys.values()
        )

    schema = yaml.safe_load((project / "workflow/schemas/config.schema.yaml").read_text())
    assert n_keys(schema["properties"]) <= MOST_KEYS


def test_a_number_is_counted_by_its_name_and_its_comment():
    source = "# A guess\nA, B = 1, 2.5\nC: int = 3  # measured\nNAMES = ('a',)\nlower = 4\n"
    found = [(name, guess) for name, guess, _ in count_numbers.named_numbers(source)]
    assert found == [("A", True), ("B", True), ("C", False)]
