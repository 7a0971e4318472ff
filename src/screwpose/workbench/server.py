"""The server: a socket on this machine, the guard before it, files for the pages, and the pages."""

import asyncio
import contextlib
import secrets
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from nicegui import app as nicegui_app
from nicegui import ui

from screwpose.errors import InputError, OutputError
from screwpose.workbench.endpoints import add_endpoints
from screwpose.workbench.guard import LOOPBACK, Guard
from screwpose.workbench.page_case import case_page
from screwpose.workbench.page_start import start_page
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.workspace import address_of, workspace_of

_STATIC = Path(__file__).parent / "static"
_LONGEST_MESSAGE = 4 * 2**20  # of a browser: long strokes of a brush are the longest


def serve(path: Path | None, ready: Callable[[str], None], host: str = "127.0.0.1", port: int = 0) -> None:
    """Serve the workbench until it is stopped.

    Parameters
    ----------
    path : a case, or a folder of cases; None: the user's own.
    ready : called with the address once it answers there.
    host : where to listen. Anywhere but on this machine itself a token is asked for, which is in the address.
    port : 0 for any that is free.

    Raises
    ------
    InputError
        There is no such case, or no such host.
    OutputError
        The port is taken.
    """
    workspace = workspace_of(path)
    listening = _listening(host, port)
    port = listening.getsockname()[1]
    is_local = host in LOOPBACK
    token = None if is_local else secrets.token_urlsafe(24)
    address = f"http://{f'[{host}]' if ':' in host else _shown(host)}:{port}"
    address += address_of(workspace.first) if workspace.first else "/"
    address += f"?token={token}" if token else ""
    sessions = Sessions(workspace)
    own = FastAPI(openapi_url=None)
    add_endpoints(own, sessions, _STATIC)
    ui.page("/", title="screwpose")(lambda: start_page(sessions))

    @ui.page("/case/{key}", title="screwpose", response_timeout=30.0)
    async def _case(key: str) -> None:
        await case_page(sessions, key)

    ui.run_with(
        own, title="screwpose", dark=None, tailwind=False, show_welcome_message=False, reconnect_timeout=10.0,
        favicon=_STATIC / "favicon.svg",
    )  # fmt: skip
    nicegui_app.on_shutdown(sessions.close)
    hosts = LOOPBACK if is_local else (*LOOPBACK, host, _shown(host), socket.gethostname(), *_own_addresses(host))
    guarded = Guard(own, hosts, port, token)
    config = uvicorn.Config(
        guarded, log_level="warning", ws_max_size=_LONGEST_MESSAGE, timeout_graceful_shutdown=2, server_header=False
    )
    server = _Telling(config, partial(ready, address))
    with contextlib.suppress(KeyboardInterrupt):  # is how it is ended
        asyncio.run(server.serve(sockets=[listening]))


class _Telling(uvicorn.Server):
    """Says so once it answers, and not before."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if not self.should_exit:
            self._ready()


def _listening(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InputError(f"there is no host {host!r} ({error.strerror})", field="--host") from error
    listening = socket.socket(family, kind, protocol)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(place)
    except OSError as error:
        listening.close()
        raise OutputError(f"{host}:{port} cannot be listened on: {error.strerror}. Choose another --port.") from error
    return listening


def _shown(host: str) -> str:
    """A host that a browser can be sent to."""
    return "127.0.0.1" if host in ("0.0.0.0", "") else host


def _own_addresses(host: str) -> list[str]:
    """The addresses under which all interfaces are asked."""
    if host not in ("0.0.0.0", "::"):
        return []
    try:
        return [str(one[4][0]) for one in socket.getaddrinfo(socket.gethostname(), None)]
    except OSError:
        return []
