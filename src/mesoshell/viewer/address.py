"""Where a viewer's page may be opened: a free port, and sockets that its own page opens."""

import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import partial
from typing import Any

import viser
import websockets.asyncio.server

from mesoshell.errors import Argument, InputError


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server at this very address. Raises InputError if another program has taken the port."""
    with own_sockets(host, port):
        server = viser.ViserServer(host=host, port=port, label="mesoshell", verbose=False)
    if server.get_port() != port:  # another program took it in the meantime; viser takes the next one
        server.stop()
        raise InputError(Argument("port"), f"{host}:{port} was taken in the meantime")
    server.request_share_url = lambda verbose=True: None  # or any client could open a tunnel to this machine
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server


@contextmanager
def own_sockets(host: str, port: int) -> Iterator[None]:
    """Servers that begin here answer sockets of their own page alone, or of programs that send no Origin."""
    # viser prints a table of addresses; the command says its own line
    serve: Any = websockets.asyncio.server.serve
    places = [f"http://{name.lower()}" for name in own_names(host)]
    origins = [None, *(f"{place}:{port}" for place in places), *(places if port == 80 else ())]
    websockets.asyncio.server.serve = partial(serve, origins=origins)  # type: ignore
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        websockets.asyncio.server.serve = serve


def own_names(host: str) -> set[str]:
    """What browsers may call a server that listens on `host`: of all addresses, this machine's names and addresses."""
    names = {host, "127.0.0.1", "localhost"}
    if host in ("", "0.0.0.0"):
        own = socket.gethostname()
        names |= {own, socket.getfqdn()}
        with suppress(OSError):
            names |= {str(entry[4][0]) for entry in socket.getaddrinfo(own, None)}
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as route:
            route.connect(("192.0.2.1", 9))  # sends nothing, and tells the address that others see
            names.add(route.getsockname()[0])
    return names


def check_port(host: str, port: int) -> None:
    """Raise InputError unless the port is free: viser would take another one and not say so."""
    if not 0 < port < 65536:
        raise InputError(Argument("port"), f"must be from 1 to 65535, not {port}")
    try:
        socket.getaddrinfo(host, port)
    except OSError as fault:
        raise InputError(Argument("host"), f"{host} is no address of this machine: {fault}") from fault
    try:
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
    except OSError as fault:
        raise InputError(Argument("port"), f"{host}:{port} cannot be listened on: {fault}") from fault
