"""The server behind `cherrypicker serve`: results to read, one file a tree to write.

It listens on the loopback interface alone. A page of another site can still send requests there
from the user's own browser, so a request must name this host, which one through a foreign name that
is made to point here (DNS rebinding) does not, and a change must come from our own page: from this
origin and with a header of our own, which a browser sends to another origin only if that agrees.

``GET /api/edits/TREE`` answers 200 with YAML, or 204 where there are no edits; ``PUT`` of YAML,
with the header, 200 and ``{"path": ..., "lost": [...]}``, or 4xx and ``{"error": ...}``.
"""

import json
import logging
import os
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from cherrypicker.batch.batch import Batch
from cherrypicker.command.saved_edits import edits_file, save_edits
from cherrypicker.errors import StageError

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"
API = "/api/edits/"
LARGEST_BODY = 200_000  # bytes: two thousand edits
_OWN_NAMES = ("127.0.0.1", "localhost")
_EDIT_HEADER, _EDIT_VALUE = "X-CherryPicker", "edit"
_YAML = "text/yaml"
_PATIENCE_S = 30.0  # for a request that stops in the middle


def make_server(batch: Batch, port: int) -> ThreadingHTTPServer:
    """Return a server of the current work folder, which listens already.

    The batch's trees are those whose edits can be read and written; port 0 takes one that is free.
    A `StageError` where the port is taken.
    """
    try:
        return ThreadingHTTPServer((HOST, port), partial(Handler, batch))
    except (OSError, OverflowError) as error:
        raise StageError(f"port {port} cannot be used ({error})", key="--port") from error


class _RefusedError(Exception):
    """A request that is answered with an error: its status and the reason."""


class Handler(SimpleHTTPRequestHandler):
    """Answers one request."""

    server: ThreadingHTTPServer
    server_version, sys_version = "CherryPicker", ""
    timeout = _PATIENCE_S

    def __init__(self, batch: Batch, *request: Any) -> None:
        self._batch = batch
        super().__init__(*request, directory="results")

    def do_GET(self) -> None:
        """Send a page, a figure, or a tree's edits."""
        self._answer(self._get)

    def do_HEAD(self) -> None:
        """Tell of a page or a figure."""
        self._answer(super().do_HEAD)

    def do_PUT(self) -> None:
        """Save a tree's edits."""
        self._answer(self._put)

    def translate_path(self, path: str) -> str:
        """Return the file of a path; what a link leads to outside the results is refused."""
        file = Path(super().translate_path(path))
        if not file.resolve().is_relative_to(Path(self.directory).resolve()):
            raise _RefusedError(HTTPStatus.FORBIDDEN, "the file lies outside the results")
        return str(file)

    def list_directory(self, path: str | os.PathLike) -> None:
        """Refuse to list a folder."""
        raise _RefusedError(HTTPStatus.NOT_FOUND, "there is no such page")

    def end_headers(self) -> None:
        """Add what keeps browsers from guessing types, keeping pages and framing them."""
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", "frame-ancestors 'none'")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Leave requests to the log, which is silent but for warnings."""
        logger.info(format, *args)

    def _answer(self, answer: Callable[[], object]) -> None:
        """Answer what is asked of this host, and not by a page of another one."""
        own = {f"{name}:{self.server.server_port}" for name in _OWN_NAMES}
        try:
            if self.headers.get("Host") not in own:
                raise _RefusedError(HTTPStatus.FORBIDDEN, "this server answers to localhost alone")
            if self.headers.get("Origin") not in {None, *(f"http://{name}" for name in own)}:
                raise _RefusedError(HTTPStatus.FORBIDDEN, "the request comes from another site")
            answer()
        except _RefusedError as refusal:
            self._send_json(*refusal.args)
        except StageError as error:
            self._send_json(HTTPStatus.UNPROCESSABLE_ENTITY, error.describe())
        except OSError as error:
            reason = f"cannot be written or read ({error.strerror})"
            self._send_json(HTTPStatus.INTERNAL_SERVER_ERROR, reason)

    def _get(self) -> None:
        path = urlsplit(self.path).path
        if path == "/":
            self._send(HTTPStatus.FOUND, {"Location": "/summary.html"})
        elif not path.startswith(API):
            super().do_GET()
        elif (edits := edits_file(self._batch, self._tree())).is_file():
            kind = {"Content-Type": f"{_YAML}; charset=utf-8"}
            self._send(HTTPStatus.OK, kind, edits.read_bytes())
        else:
            self._send(HTTPStatus.NO_CONTENT)

    def _tree(self) -> str:
        """Return the tree of a request for edits."""
        tree = unquote(urlsplit(self.path).path.removeprefix(API))
        if not self._batch.has(tree):
            raise _RefusedError(HTTPStatus.NOT_FOUND, f"there is no tree {tree!r} in the table")
        return tree

    def _put(self) -> None:
        if not urlsplit(self.path).path.startswith(API):
            raise _RefusedError(HTTPStatus.METHOD_NOT_ALLOWED, "only edits can be written")
        tree = self._tree()
        if self.headers.get(_EDIT_HEADER) != _EDIT_VALUE:
            reason = f"the header {_EDIT_HEADER}: {_EDIT_VALUE} is missing"
            raise _RefusedError(HTTPStatus.FORBIDDEN, reason)
        if self.headers.get_content_type() != _YAML:
            raise _RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, f"edits are {_YAML}")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            raise _RefusedError(HTTPStatus.LENGTH_REQUIRED, "the length of the edits is missing")
        if int(length) > LARGEST_BODY:
            reason = f"edits are {LARGEST_BODY:,} bytes at most"
            raise _RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, reason)
        body = self.rfile.read(int(length))
        if len(body) < int(length):
            raise _RefusedError(HTTPStatus.BAD_REQUEST, "the edits end before their length")
        self._send_json(HTTPStatus.OK, save_edits(self._batch, tree, body))

    def _send_json(self, status: HTTPStatus, told: dict | str) -> None:
        """Send what was done, or why it was not."""
        body = json.dumps({"error": told} if isinstance(told, str) else told).encode()
        self._send(status, {"Content-Type": "application/json"}, body)

    def _send(self, status: HTTPStatus, headers: dict | None = None, body: bytes = b"") -> None:
        self.send_response(status)
        for name, value in (headers or {}).items():
            self.send_header(name, value)
        if body:
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)
