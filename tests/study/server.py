"""A private PostgreSQL server for tests."""

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.needs import need

PASSWORD = "hunter2-Zx9"


def binaries():
    """The folder of initdb and postgres, newest version first; None where there is none."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda p: float(p.parts[4]), reverse=True)
    found += [Path(path).resolve() for path in [shutil.which("initdb")] if path]
    return found[0].parent if found else None


def _as_user():
    """What a command begins with, as a server refuses to run as root, and who that is."""
    if os.geteuid() != 0:
        return [], None
    for name in ("postgres", "nobody"):
        try:
            user = pwd.getpwnam(name)
        except KeyError:
            continue
        return ["setpriv", f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"], user
    return None, None


def free_port():
    """A port that nobody is given who asks for any free one, so that it stays free while the server is down."""
    for port in range(20000 + os.getpid() % 10000, 32768):
        with socket.socket() as attempt, suppress(OSError):
            attempt.bind(("127.0.0.1", port))
            return port
    raise OSError("no free port")


class Server:
    """A server with an empty data folder on a free port of this machine; its user eiwa has a password."""

    def __init__(self, folder):
        self.bin = need("postgres", binaries(), "no PostgreSQL server is installed (initdb)")
        self.folder, (self._as, user) = folder, _as_user()
        need("postgres", self._as is not None, "no user that could run a PostgreSQL server")
        if user:
            os.chown(folder, user.pw_uid, user.pw_gid)
        (folder / "password").write_text(PASSWORD)
        (folder / "password").chmod(0o644)
        options = ["-U", "eiwa", "-A", "scram-sha-256", f"--pwfile={folder / 'password'}", "--no-sync", "-E", "UTF8"]
        self._run("initdb", "-D", folder / "data", *options, "--locale=C")
        self.port = free_port()
        self.start()

    def _run(self, name, *arguments):
        command = [*self._as, self.bin / name, *arguments]
        subprocess.run(list(map(str, command)), check=True, capture_output=True, cwd=self.folder)

    def start(self):
        settings = ["listen_addresses=127.0.0.1", f"unix_socket_directories={self.folder}", "fsync=off"]
        options = [word for setting in settings for word in ("-c", setting)]
        command = [*self._as, self.bin / "postgres", "-D", self.folder / "data", "-p", self.port, *options]
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(list(map(str, command)), stdout=log, stderr=log, cwd=self.folder)
        end = time.monotonic() + 120
        while subprocess.run(
            [self.bin / "pg_isready", "-q", "-h", "127.0.0.1", "-p", str(self.port)], check=False
        ).returncode:
            assert self._process.poll() is None, (self.folder / "log").read_text()
            assert time.monotonic() < end
            time.sleep(0.05)

    def stop(self):
        """At once, as a server that crashes."""
        if self._process.poll() is None:
            self._run("pg_ctl", "-D", self.folder / "data", "stop", "-m", "immediate")
            self._process.wait()

    def url(self, database, password=False):
        """Of a new or known database."""
        import psycopg

        options = {"host": "127.0.0.1", "port": self.port, "user": "eiwa", "password": PASSWORD, "dbname": "postgres"}
        with psycopg.connect(**options, autocommit=True) as connection:
            if not connection.execute("SELECT 1 FROM pg_database WHERE datname = %s", [database]).fetchone():
                connection.execute(f'CREATE DATABASE "{database}"')
        secret = f":{PASSWORD}" if password else ""
        return f"postgresql://eiwa{secret}@127.0.0.1:{self.port}/{database}"


@contextmanager
def running():
    """A server for a while."""
    folder = Path(tempfile.mkdtemp(prefix="eiwa-postgres-"))
    server = None
    try:
        server = Server(folder)
        yield server
    finally:
        if server:
            server.stop()
        shutil.rmtree(folder)
