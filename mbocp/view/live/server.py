"""viser's server, for its own page alone.

A browser lets any page open a WebSocket to this machine. viser takes them all, and has no option for it, so
that what it asks of `websockets` is completed while it starts: who comes from another page, or by a name that
may stand for any machine, is refused. Frames in the wrong form end their connection without a word.
"""

from __future__ import annotations

import contextlib
import http
import io
import ipaddress
import logging
import socket
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

from mbocp.exceptions import ReplayError
from mbocp.view.live.live_scene import viser_module

_FOREIGN = "This page is for the browser that opened it.\n"
_HEAD = b"<head>"
_DARK = b"""<style>@media (prefers-color-scheme: dark) { canvas { filter: brightness(0.82); } }</style>
<script>
  const scheme = "data-mantine-color-scheme", root = document.documentElement;
  const follow = () => {
    if (root.getAttribute(scheme) !== "dark") { root.setAttribute(scheme, "dark"); }
  };
  if (matchMedia("(prefers-color-scheme: dark)").matches) { // viser's own theme is that of the server
    new MutationObserver(follow).observe(root, { attributeFilter: [scheme] });
    follow();
  }
</script>"""


def page_server(host: str, port: int, label: str) -> Any:
    """Start viser's server at an address, and the first free port from one on.

    Raises
    ------
    ReplayError
        If it does not start as viser 1 does, and would take pages of others.
    """
    viser = viser_module()
    with contextlib.redirect_stdout(io.StringIO()), _guard(host) as guards:  # it announces itself there
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    if not guards:
        server.stop()
        raise ReplayError("live view: this version of viser is not known: pip install 'mbocp[live]'")
    return server


def is_own_page(asked: str, origin: str | None, host: str = "localhost") -> bool:
    """Whether a request comes from the page that it goes to.

    Parameters
    ----------
    asked : str
        Name, or address, and port to which it goes.
    origin : str, optional
        Page from which it comes, where a browser sends it.
    host : str
        A further name of this machine. Names beside it, "localhost" and the machine's own may be made to
        stand for it by those who own them.
    """
    try:
        name = urlsplit(f"//{asked}").hostname or ""
        page = None if origin is None else urlsplit(origin).netloc
    except ValueError:
        return False
    if not (_is_address(name) or name in ("localhost", socket.gethostname().lower(), host.lower())):
        return False
    return page is None or page.lower() == asked.lower()


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


@contextlib.contextmanager
def _guard(name: str) -> Iterator[list[Callable[..., Any]]]:
    """Let servers of `websockets` that are started meanwhile look at requests; those that do so."""
    import websockets.asyncio.server as module

    serve, guards = module.serve, list[Callable[..., Any]]()

    def serve_guarded(*args: Any, process_request: Any = None, **options: Any) -> Any:
        def guard(connection: Any, request: Any) -> Any:
            host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
            if not is_own_page(host, origin, name):
                return connection.respond(http.HTTPStatus.FORBIDDEN, _FOREIGN)
            if request.path.partition("?")[0] == "/" and "Accept-Encoding" in request.headers:
                del request.headers["Accept-Encoding"]  # so that the page comes as text
            return _in_dark(process_request(connection, request)) if process_request is not None else None

        guards.append(guard)
        return serve(*args, process_request=guard, **{"logger": _silent(), **options})

    module.serve = serve_guarded  # type: ignore[misc,assignment]
    try:
        yield guards
    finally:
        module.serve = serve  # type: ignore[misc]


def _in_dark(response: Any) -> Any:
    """The page with a script that keeps its panel dark, where the browser asks for that."""
    if response is not None and _HEAD in response.body[:200]:
        response.body = response.body.replace(_HEAD, _HEAD + _DARK, 1)
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response


def _silent() -> logging.Logger:
    """A logger that prints nothing unless somebody listens to it."""
    logger = logging.getLogger("mbocp.live")
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger
