"""A real Slurm of one node on loopback, from Debian's packages, for the time of a test."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import tempfile
import time
from pathlib import Path

HOW_TO_INSTALL = "apt-get install --no-install-recommends slurm-wlm munge"
DAEMONS = ("munged", "slurmctld", "slurmd")
CLIENTS = ("sbatch", "squeue", "scancel", "srun", "sinfo", "scontrol", "sacct", "sacctmgr")
SYSTEM_PATH = "/usr/sbin:/sbin:/usr/bin:/bin"

SLURM_CONF = """\
ClusterName=loopback
SlurmctldHost={host}({address})
SlurmUser={user}
SlurmdUser={user}
SlurmctldPort={controller_port}
SlurmdPort={node_port}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
# A container has neither cgroups of its own nor a database of jobs
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
# squeue must still know a job when its status is asked for
MinJobAge=300
# Memory is a resource, and a job that outgrows what it asked for is killed
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
JobAcctGatherParams=OverMemoryKill
# The node may claim more CPUs than the machine has
SlurmdParameters=config_overrides
SchedulerParameters=sched_interval=2,sched_min_interval=100000
KillWait=2
GresTypes=gpu
NodeName={host} NodeAddr={address} CPUs={cpus} RealMemory={memory_mb} Gres=gpu:1 State=UNKNOWN
PartitionName=test Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def missing_daemons() -> list[str]:
    """Return the programs that are not installed."""
    return [name for name in (*DAEMONS, *CLIENTS[:4]) if not _program(name)]


class SlurmCluster:
    """``with SlurmCluster() as cluster``: munged, slurmctld and slurmd; ``cluster.environment``.

    Everything lies in one short-named folder (a socket's path may have 107 characters), which goes
    when the cluster does.
    """

    def __init__(self, cpus: int = 4, memory_mb: int = 12000):
        self.folder = Path(tempfile.mkdtemp(prefix="slurm", dir="/tmp"))
        self.folder.chmod(0o755)
        self._daemons: list[subprocess.Popen] = []
        self._cpus, self._memory_mb = cpus, memory_mb

    @property
    def environment(self) -> dict[str, str]:
        """Variables for a process that submits jobs.

        Snakemake drops ``SLURM_*`` variables inside a job, so the clients come as wrappers in PATH.
        """
        path = f"{self.folder}/bin:{os.environ.get('PATH', '')}:{SYSTEM_PATH}"
        return {**os.environ, "PATH": path, "PYTHONPATH": ""}

    def __enter__(self) -> SlurmCluster:
        try:
            self._configure()
            self._start_munged()
            self._start("slurmctld", "-D", "-f", self.folder / "slurm.conf")
            self._start("slurmd", "-D", "-f", self.folder / "slurm.conf")
            self._wait_for("an idle node", lambda: "idle" in self.ask("sinfo", "-h", "-o", "%t"))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_) -> None:
        for daemon in reversed(self._daemons):
            daemon.terminate()
            try:
                daemon.wait(timeout=10)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def ask(self, *command: str) -> str:
        """Run one of Slurm's clients; return what it prints, errors included."""
        done = subprocess.run(
            command,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=60,
            check=False,
        )
        return done.stdout.strip()

    def jobs(self) -> dict[str, dict[str, str]]:
        """Return every job that Slurm knows: its id and the fields of ``scontrol show job``."""
        jobs = {}
        for line in self.ask("scontrol", "--oneliner", "show", "job").splitlines():
            fields = dict(part.split("=", 1) for part in line.split() if "=" in part)
            if "JobId" in fields:
                jobs[fields["JobId"]] = fields
        return jobs

    def _configure(self) -> None:
        for name in ("bin", "state", "spool", "munge"):
            (self.folder / name).mkdir(mode=0o700 if name == "munge" else 0o755)
        host = socket.gethostname().split(".")[0]
        controller_port, node_port = _free_ports(2)
        settings = {
            "host": host,
            "address": _loopback_address(),
            "user": getpass.getuser(),
            "folder": self.folder,
            "controller_port": controller_port,
            "node_port": node_port,
            "cpus": self._cpus,
            "memory_mb": self._memory_mb,
        }
        (self.folder / "slurm.conf").write_text(SLURM_CONF.format(**settings))
        # A GPU that is only counted, to see which jobs ask for one
        (self.folder / "gres.conf").write_text("Name=gpu File=/dev/null\n")
        (self.folder / "cgroup.conf").write_text("CgroupPlugin=cgroup/v1\n")
        for name in CLIENTS:
            program = _program(name)
            if program:
                wrapper = self.folder / "bin" / name
                wrapper.write_text(
                    f'#!/bin/sh\nexport SLURM_CONF={self.folder}/slurm.conf\nexec {program} "$@"\n'
                )
                wrapper.chmod(0o755)

    def _start_munged(self) -> None:
        key = self.folder / "munge" / "key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o400)
        self._start(
            *("munged", "--foreground", "--force", f"--key-file={key}"),
            f"--socket={self.folder}/munge.socket",
            f"--pid-file={self.folder}/munge/pid",
            f"--log-file={self.folder}/munge/log",
            f"--seed-file={self.folder}/munge/seed",
        )
        self._wait_for("munged's socket", (self.folder / "munge.socket").exists)

    def _start(self, name: str, *arguments: object) -> None:
        log = (self.folder / f"{name}.out").open("wb")
        with log:
            self._daemons.append(
                subprocess.Popen(
                    [_program(name), *map(str, arguments)],
                    cwd=self.folder,
                    env={**os.environ, "SLURM_CONF": str(self.folder / "slurm.conf")},
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
            )

    def _wait_for(self, what: str, is_there, timeout_s: float = 30.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not is_there():
            dead = [daemon.args[0] for daemon in self._daemons if daemon.poll() is not None]
            if dead or time.monotonic() > deadline:
                logs = sorted(self.folder.glob("*.log")) + sorted(self.folder.glob("*.out"))
                tails = [f"{path.name}:\n{path.read_text()[-1500:]}" for path in logs]
                raise RuntimeError(f"waited for {what}; ended: {dead}\n" + "\n".join(tails))
            time.sleep(0.1)


def _program(name: str) -> str | None:
    return shutil.which(name, path=f"{SYSTEM_PATH}:{os.environ.get('PATH', '')}")


def _loopback_address() -> str:
    """The address that the machine's own name stands for: srun in a job uses no other."""
    try:
        return socket.gethostbyname(socket.gethostname())
    except OSError:
        return "127.0.0.1"


def _free_ports(n_ports: int) -> list[int]:
    sockets = [socket.socket() for _ in range(n_ports)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
    finally:
        for one in sockets:
            one.close()
