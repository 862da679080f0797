"""The server of the pages: what it serves, what it writes, and all that it refuses."""

import dataclasses
import http.client
import json
import threading

import numpy as np
import pytest
import yaml
from finished_tree import write_finished_tree

from cherrypicker.command.server import API, LARGEST_BODY, make_server
from cherrypicker.command.work_folder import batch_here
from cherrypicker.errors import StageError
from cherrypicker.skeleton import read_skeleton, write_skeleton_graphml
from cherrypicker.skeleton.edits import read_edits

SAVE = {"X-CherryPicker": "edit", "Content-Type": "text/yaml"}


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A work folder with one finished tree, and a secret beside it."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "secret.txt").write_text("secret")
    (folder / "config").mkdir()
    (folder / "config/trees.tsv").write_text("tree\tcloud\nsmall\tnone.ply\nunmade\tnone.ply\n")
    write_finished_tree(folder / "results/small")
    (folder / "results/summary.html").write_text("<title>batch</title>")
    (folder / "results/link.html").symlink_to(folder / "secret.txt")
    return folder


@pytest.fixture
def ask(work, monkeypatch):
    """Return a function that asks the server, and gives status, headers and body."""
    monkeypatch.chdir(work)
    (work / "config/edits/small.yaml").unlink(missing_ok=True)
    with make_server(batch_here(), 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()

        def request(method, path, body=None, **headers):
            link = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
            named = {name.replace("_", "-"): value for name, value in headers.items()}
            link.request(method, path, body, named)
            answer = link.getresponse()
            return answer.status, answer.headers, answer.read()

        request.port = server.server_port
        yield request
        server.shutdown()
        thread.join()


def edits(at, kind="delete", **more):
    place = [round(float(value), 6) for value in at]
    return yaml.safe_dump({**more, "edits": [{kind: {"at": place}}]}).encode()


def put(ask, body, tree="small", **headers):
    status, _, answer = ask("PUT", f"{API}{tree}", body, **(SAVE | headers))
    return status, json.loads(answer)


@pytest.fixture
def tip(work):
    """Where a lateral ends."""
    return np.array([0.5, 0.1, 0.9])


def test_pages_are_served(ask):
    assert ask("GET", "/small/report.html")[2] == b"<title>small</title>"
    assert ask("GET", "/summary.html")[0] == 200
    status, headers, _ = ask("GET", "/")
    assert status == 302 and headers["Location"] == "/summary.html"
    assert ask("HEAD", "/summary.html")[0] == 200


@pytest.mark.parametrize(
    "path",
    [
        "/../secret.txt",
        "/%2e%2e/secret.txt",
        "/small/..%2f..%2f..%2fsecret.txt",
        "//etc/passwd",
        "/link.html",
        "/small/",
        "/none.html",
        "/api/edits/../../secret.txt",
        "/api/edits/..%2fsmall",
    ],
)
def test_nothing_else_is_served(ask, path):
    status, _, body = ask("GET", path)
    assert status in (403, 404) and body != b"secret"


def test_edits_are_saved_and_told_again(ask, work, tip):
    assert ask("GET", f"{API}small")[0] == 204
    status, answer = put(ask, edits(tip))
    assert (status, answer) == (200, {"path": "config/edits/small.yaml", "lost": []})
    status, headers, body = ask("GET", f"{API}small")
    assert status == 200 and headers.get_content_type() == "text/yaml" and body == edits(tip)
    (one,) = read_edits(work / "config/edits/small.yaml")
    assert one.kind == "delete"
    assert put(ask, edits(tip, "cut"), Origin=f"http://localhost:{ask.port}")[0] == 200


def test_a_solved_skeleton_of_an_earlier_run_is_not_looked_at(ask, work, tip):
    folder = work / "results/small"
    shown = read_skeleton(folder / "skeleton.graphml")
    stale = dataclasses.replace(shown, points=shown.points + [9.0, 0.0, 0.0])
    write_skeleton_graphml(folder / "solved.graphml", stale)
    for _ in range(2):  # the second time there are edits already
        assert put(ask, edits(tip))[1]["lost"] == []
    (folder / "edits.json").write_text("{}")  # the skeleton is made of solved.graphml
    assert "another tree" in put(ask, edits(tip))[1]["error"]
    (folder / "edits.json").unlink()
    (folder / "solved.graphml").unlink()


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8321", "127.0.0.1", ""])
def test_another_host_is_refused(ask, tip, host):
    assert ask("GET", "/summary.html", Host=host)[0] == 403
    assert put(ask, edits(tip), Host=host)[0] == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_another_origin_is_refused(ask, work, tip, origin):
    assert put(ask, edits(tip), Origin=origin)[0] == 403
    assert not (work / "config/edits/small.yaml").exists()


def test_a_form_of_another_site_is_refused(ask, tip):
    assert ask("PUT", f"{API}small", edits(tip), Content_Type="text/yaml")[0] == 403
    assert put(ask, edits(tip), **{"Content-Type": "text/plain"})[0] == 415
    assert ask("POST", f"{API}small", edits(tip), **SAVE)[0] == 501
    assert ask("OPTIONS", f"{API}small")[0] == 501
    assert ask("PUT", "/small/report.html", edits(tip), **SAVE)[0] == 405


def test_bodies_have_a_length_and_a_limit(ask):
    assert ask("PUT", f"{API}small", None, **SAVE, Content_Length=str(LARGEST_BODY + 1))[0] == 413
    assert ask("PUT", f"{API}small", None, **SAVE, Content_Length="-1")[0] == 411
    assert ask("PUT", f"{API}small", None, **SAVE, Transfer_Encoding="chunked")[0] == 411


@pytest.mark.parametrize(
    "body, reason",
    [
        (b"edits: [", "cannot be read"),
        (b"\xff\xfe", "cannot be read"),
        (b"[" * 100_000, "deeper"),
        (b"edits: !!bool x", "does not fit its tag"),
        (b"edits: {delete: 1}", "list"),
        (b"edits: [{burn: {at: [0, 0, 1]}}]", "an edit has"),
        (b"edits: [{delete: {at: [0, 0]}}]", "three finite"),
        (b"a: &a [0, 0, 1]\nb: &b {at: *a}\nedits: [{delete: *b}]", "inside another"),
        (b"edits: [{delete: {at: [5, 5, 5]}}]", "another tree"),
        (b"tree: other\nedits: []", "of tree 'other'"),
        (b"edits: [{delete: {at: [0, 0, 0]}}]", "root"),
        (b"edits: [{connect: {from: [0.05, 0, 1.0], to: [0.05, 0, 1.4]}}]", "cycle"),
        (b"!!python/object/apply:os.system [ls]", "cannot be read"),
    ],
)
def test_what_are_no_edits_of_this_tree_is_refused(ask, work, body, reason):
    status, answer = put(ask, body)
    assert status == 422 and reason in answer["error"], answer
    assert "small.yaml" in answer["error"] and "part" not in answer["error"]
    assert not (work / "config/edits/small.yaml").exists()


def test_trees_without_a_skeleton_or_a_row_have_no_edits(ask, tip):
    assert put(ask, edits(tip), "unmade")[0] == 422
    assert put(ask, edits(tip), "stranger")[0] == 404
    assert ask("GET", f"{API}stranger")[0] == 404


def test_a_lost_edit_is_told(ask, tip):
    body = edits(tip).decode() + "- delete: {at: [9, 9, 9]}\n"
    status, answer = put(ask, body.encode())
    assert status == 200 and len(answer["lost"]) == 1


def test_a_taken_port_is_told(ask):
    with pytest.raises(StageError, match="port"):
        make_server(batch_here(), ask.port)
