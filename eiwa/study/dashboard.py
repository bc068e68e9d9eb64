"""Serves the page of a study: optuna-dashboard on this machine, for reading only."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable, Iterable, Iterator
from socketserver import ThreadingMixIn
from threading import Event, Thread
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from eiwa.core.errors import EiwaError
from eiwa.study import journal
from eiwa.study.page import READ_ONLY, Page, front

POLL = 1.0
"""Seconds between two looks for new rows."""


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True


class _Quiet(WSGIRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal has better things to say."""


def require() -> Any:
    """The package optuna_dashboard.

    Raises
    ------
    EiwaError
        It is not installed.
    """
    try:
        import optuna_dashboard
    except ImportError:
        raise EiwaError("the dashboard needs optuna-dashboard: pip install 'eiwa[dashboard]'") from None
    return optuna_dashboard


def listening(page: Page, host: str, port: int) -> WSGIServer:
    """A server of the page that answers as soon as its ``serve_forever`` is called; port 0 takes a free one.

    Raises
    ------
    EiwaError
        The address cannot be used, or optuna-dashboard is missing.
    """
    dashboard = require()
    # optuna-dashboard's own front counts trials that break constraints.
    dashboard._app.get_pareto_front_trials = front
    journal.quiet()
    app = dashboard.wsgi(page)
    try:
        return make_server(host, port, reading_only(app), _Server, _Quiet)
    except OverflowError:
        raise EiwaError(f"--port {port}: must be 0 to 65535") from None
    except OSError as error:
        remedy = "choose another with --port; 0 takes a free one"
        if error.errno == errno.EADDRINUSE:
            raise EiwaError(f"--port {port}: is in use; {remedy}") from None
        raise EiwaError(f"--host {host} --port {port}: cannot be listened on: {error.strerror}; {remedy}") from None


def reading_only(app: Any) -> Any:
    """A WSGI application that refuses every request that would change something, with the reason."""

    def guarded(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        environ.setdefault("HTTP_ACCEPT_ENCODING", "")  # optuna-dashboard fails without this header, as from curl
        if environ["REQUEST_METHOD"] in ("GET", "HEAD"):
            answer: Iterable[bytes] = app(environ, start_response)
            return answer
        body = json.dumps({"reason": READ_ONLY}).encode()
        start_response("403 Forbidden", [("Content-Type", "application/json"), ("Content-Length", str(len(body)))])
        return [body]

    return guarded


def serve(server: WSGIServer, updates: Iterator[bool]) -> None:
    """Answer requests, and show what is new, until an interrupt."""
    stop = Event()
    thread = Thread(target=_follow, args=(updates, stop), daemon=True)
    thread.start()
    try:
        server.serve_forever()
    finally:
        stop.set()
        server.server_close()


def _follow(updates: Iterator[bool], stop: Event) -> None:
    while not stop.is_set():
        if not next(updates):
            stop.wait(POLL)
