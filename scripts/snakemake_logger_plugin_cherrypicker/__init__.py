"""Snakemake's logger plugin ``cherrypicker``: what a run tells, as JSON for another program.

Each record is one line on the standard error: a record separator, then a JSON object (RFC 7464).
Every other line there is a job's own. `cherrypicker run` reads both; by hand:

    PYTHONPATH=PROJECT/scripts snakemake --logger cherrypicker

Snakemake finds a plugin by the name of its package, on Python's path.
"""

from __future__ import annotations

import json
import logging
import os
import sys

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent

SEPARATOR = "\x1e"
# Of the events that have a meaning beyond their text, what is passed on
_FIELDS: dict[str, tuple[str, ...]] = {
    LogEvent.RUN_INFO: ("stats",),
    LogEvent.RESOURCES_INFO: ("cores",),
    LogEvent.JOB_INFO: ("jobid", "rule_name", "rule_msg", "wildcards", "log"),
    LogEvent.JOB_STARTED: ("jobs",),
    LogEvent.JOB_FINISHED: ("job_id",),
    LogEvent.JOB_ERROR: ("jobid", "rule_name"),
    LogEvent.PROGRESS: ("done", "total"),
    LogEvent.ERROR: ("exception",),
}
# Told by their fields alone while jobs write to the same stream: a short line arrives whole
_WITHOUT_TEXT = frozenset(_FIELDS) - {LogEvent.RUN_INFO, LogEvent.RESOURCES_INFO, LogEvent.ERROR}


class LogHandler(LogHandlerBase):
    """Writes records in place of Snakemake's own console."""

    writes_to_stream = True
    writes_to_file = False
    has_filter = False
    has_formatter = False
    needs_rulegraph = False

    def filter(self, record: logging.LogRecord) -> bool:
        """Take every record; what --quiet leaves out is text, a failure is told all the same."""
        self._is_shown = bool(super().filter(record))
        return True

    def emit(self, record: logging.LogRecord) -> None:
        """Write one record."""
        event = str(getattr(record, "event", ""))
        told = {name: getattr(record, name, None) for name in _FIELDS.get(event, ())}
        told |= {"event": event, "level": record.levelno}
        has_text = event not in _WITHOUT_TEXT or self.common_settings.dryrun
        if has_text and self._is_shown:
            told["text"] = self.format(record)
        try:
            line = f"{SEPARATOR}{json.dumps(told, default=str)}\n"
            os.write(sys.stderr.fileno(), line.encode())
        except Exception:
            self.handleError(record)
