"""Who may ask, and how much: without a browser, which would not send most of this."""

import http.client
import json
import socket
import zlib

import pytest

from screwpose.workbench.guard import COOKIE, LARGEST_UPLOAD_BYTES, LOOPBACK, Guard
from screwpose.workbench.workspace import address_of
from tests.workbench.driving import awaited, case_in

HOME = "http://127.0.0.1:8000"


async def application(scope, receive, send):
    """Says how long a body was, or opens a socket."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        return
    length, more = 0, True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        length, more = length + len(message.get("body", b"")), message.get("more_body", False)
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": str(length).encode()})


def told(kind="http", method="GET", path="/", query="", body=(b"",), token=None, **headers):
    """What comes of a request to the guard: status (None where nothing is answered), text, headers."""
    named = {"host": "127.0.0.1:8000", **{key.replace("_", "-"): value for key, value in headers.items()}}
    scope = {
        "type": kind, "method": method, "path": path, "query_string": query.encode(),
        "headers": [(key.encode(), value.encode()) for key, value in named.items()],
    }  # fmt: skip
    pieces, sent = iter(body), []

    async def receive():
        piece = next(pieces, None) if kind == "http" else b""
        if kind == "websocket":
            return {"type": "websocket.connect"}
        return {"type": "http.request", "body": piece or b"", "more_body": piece is not None}

    async def send(message):
        sent.append(message)

    awaited(Guard(application, LOOPBACK, 8000, token)(scope, receive, send))
    if kind == "websocket":
        return sent[0]["type"]
    if not sent:
        return None, "", {}
    answered = {key.decode(): value.decode() for key, value in sent[0]["headers"]}
    return sent[0]["status"], b"".join(one.get("body", b"") for one in sent[1:]).decode(), answered


def test_our_own_page_may_ask():
    status, text, headers = told(method="POST", body=[b"four"], origin=HOME, sec_fetch_site="same-origin")
    assert (status, text) == (200, "4")
    policy = headers["content-security-policy"]
    for rule in ("default-src 'self'", "frame-ancestors 'none'", "object-src 'none'", "base-uri 'none'"):
        assert rule in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert told(kind="websocket", origin=HOME) == "websocket.accept"


@pytest.mark.parametrize(
    "host", ["evil.example:8000", "127.0.0.1:9000", "127.0.0.1.evil.example:8000", "localhost", "", "[::"]
)
def test_another_name_or_port_is_no_name_of_ours(host):
    assert told(host=host)[0] == 421
    assert told(kind="websocket", host=host) == "websocket.close"


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1:9999", "null", "https://127.0.0.1.evil.example:8000"]
)
def test_another_sites_page_may_not_ask(origin):
    assert told(method="POST", origin=origin)[0] == 403
    assert told(kind="websocket", origin=origin) == "websocket.close"


def test_a_cross_site_request_without_an_origin_is_refused_where_it_changes_something():
    assert told(method="POST", sec_fetch_site="cross-site")[0] == 403
    assert told(kind="websocket", sec_fetch_site="cross-site") == "websocket.close"
    assert told(sec_fetch_site="cross-site")[0] == 200  # a link to us


def test_without_the_token_nothing_is_answered():
    assert told(token="secret")[0] == 401
    assert told(token="secret", query="token=wrong")[0] == 401
    assert told(token="secret", cookie=f"{COOKIE}=wrong")[0] == 401
    assert told(kind="websocket", token="secret") == "websocket.close"
    assert told(kind="websocket", token="secret", cookie=f"{COOKIE}=secret") == "websocket.accept"


def test_the_token_goes_from_the_address_into_a_cookie_that_no_script_reads():
    status, _, headers = told(token="secret", query="token=secret")
    assert status == 303
    assert "token" not in headers["location"]
    assert "httponly" in headers["set-cookie"].lower()
    assert "samesite=strict" in headers["set-cookie"].lower()
    assert told(token="secret", cookie=f"{COOKIE}=secret")[0] == 200
    _, _, headers = told(token="secret", path="/case/no #1? 5%20", query="token=secret")
    assert headers["location"] == "/case/no%20%231%3F%205%2520"


def test_more_than_a_case_is_refused_whatever_it_says_of_its_length():
    assert told(method="POST", content_length=str(LARGEST_UPLOAD_BYTES + 1))[0] == 413
    piece = bytes(2**22)
    pieces = LARGEST_UPLOAD_BYTES // len(piece)
    assert told(method="POST", body=[piece] * pieces)[1] == str(LARGEST_UPLOAD_BYTES)
    assert told(method="POST", body=[piece] * (pieces + 1))[0] is None  # cut off


def asked(server, path, **headers):
    """A request as it is written, dots and all."""
    connection = http.client.HTTPConnection(server.base.removeprefix("http://"), timeout=30)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body, dict(answer.getheaders())


def test_the_real_server_keeps_to_its_cases(workspace, serve):
    (workspace.parent / "secret.txt").write_text("not for you")
    (workspace / "no-case").mkdir()
    (workspace / "no-case" / "case.txt").write_text("not for you")
    server = serve(workspace)
    assert asked(server, "/")[0] == 200
    for path in (
        "/export/../secret.txt", "/export/..%2f..%2fsecret.txt/case.json", "/export/demo/..%2f..%2fsecret.txt",
        "/export/demo/%2e%2e%2fcase.json", "/export/no-case/case.zip", "/static/../server.py", "/static/..%2fserver.py",
        "/pixels/..%2f..%2fsecret", f"/pixels/{'0' * 32}", "/mesh/../../secret.txt", "/export/demo/workbench.json",
    ):  # fmt: skip
        status, body, _ = asked(server, path)
        assert status in (400, 404), path
        assert b"not for you" not in body
        assert b"def serve" not in body
    for key in ("../secret", "..%2fcases", "%2e%2e", "no-case", "nothing"):
        _, body, _ = asked(server, f"/case/{key}")
        assert b"not for you" not in body
    status, _, headers = asked(server, "/export/demo/case.json")
    assert status == 200
    assert "sandbox" in headers["content-security-policy"]
    assert asked(server, "/", Host="evil.example")[0] == 421
    assert asked(server, "/_nicegui_ws/socket.io/?EIO=4&transport=polling", Origin="http://evil.example")[0] == 403


def test_a_case_of_any_name_is_opened_listed_and_exported(workspace, serve):
    name = "no #1? 50%20 & <b>"
    (workspace / "demo").rename(workspace / name)
    server = serve(workspace / name)
    path = server.address.removeprefix(server.base)
    status, page, _ = asked(server, path)
    assert status == 200
    assert b"cannot be opened" not in page
    assert path.encode() in asked(server, "/")[1]
    for wanted in ("case.json", "case.zip"):
        status, body, _ = asked(server, address_of(name, wanted))
        assert status == 200
        assert body[:2] in (b"{\n", b"PK")


def test_elsewhere_a_token_is_in_the_address_and_asked_for(workspace, serve):
    server = serve(workspace, "--host", "0.0.0.0")
    token = server.address.split("token=")[1]
    assert len(token) > 20
    assert asked(server, "/")[0] == 401
    assert asked(server, "/export/demo/case.json")[0] == 401
    assert asked(server, "/?token=" + "x" * len(token))[0] == 401
    status, _, headers = asked(server, f"/?token={token}")
    assert status == 303
    cookie = headers["set-cookie"].split(";")[0]
    assert asked(server, "/export/demo/case.json", Cookie=cookie)[0] == 200


def test_on_this_machine_it_listens_on_the_loopback_alone(workspace, serve):
    server = serve(workspace)
    port = int(server.base.rsplit(":", 1)[1])
    own = {one[4][0] for one in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {
        "127.0.0.1",
        "127.0.1.1",
    }
    for address in own:
        with pytest.raises(ConnectionRefusedError), socket.create_connection((address, port), timeout=2):
            pass
    with socket.create_connection(("127.0.0.1", port), timeout=5):
        pass


def png_bomb(side):
    """A PNG of so many pixels each way, all black: a thousandth of its size."""

    def chunk(kind, data):
        return len(data).to_bytes(4) + kind + data + zlib.crc32(kind + data).to_bytes(4)

    packer = zlib.compressobj(9)
    row = bytes(1 + 2 * side)
    data = b"".join(packer.compress(row) for _ in range(side)) + packer.flush()
    head = side.to_bytes(4) + side.to_bytes(4) + bytes([16, 0, 0, 0, 0])
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def test_a_broken_or_hostile_file_of_each_kind_is_refused_in_words(simulated, workspace, tmp_path, serve, open_tab):
    folder = workspace / "demo"
    before = case_in(folder)
    mesh = next((simulated / "models").glob("*.stl")).read_bytes()
    files = {
        "cut.png": (simulated / "ap.png").read_bytes()[:3000],
        "bomb.png": png_bomb(30_000),
        "cut.tif": b"II*\x00\x08\x00\x00\x00" + bytes(20),
        "cut.dcm": bytes(128) + b"DICM" + bytes(50),
        "cut.stl": mesh[: len(mesh) // 3],
        "wrong.obj": b"v 1 2\nf 1 2 3\n",
        "wrong.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nend_header\n",
        "wrong.step": b"ISO-10303-21;\nHEADER;\nnonsense",
        "wrong.vtk": b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET NOTHING\n",
        "wrong.json": b'{"projection": [[1, 2], [3, 4]]}',
        "deep.json": b"[" * 9000,
        "wrong.txt": b"1 2 three 4",
        "singular.txt": b"0 " * 12,
        "archive.zip": b"PK\x03\x04" + bytes(100),
        "page.html": b"<script>alert(1)</script>",
        "<img src=x onerror=alert(1)>.png": b"GIF89a",
    }
    place = tmp_path / "bad"
    place.mkdir()
    for name, data in files.items():
        (place / name).write_bytes(data)
    tab = open_tab(serve(folder).address)
    tab.text("Mark the screws").wait_for()
    tab.page.wait_for_function("document.querySelectorAll('.preview').length === 2")
    tab.give_files(*(place / name for name in files))
    tab.page.wait_for_function(
        f"document.querySelectorAll('.span .finding.error').length === {len(files)}", timeout=300_000
    )
    said = "\n".join(tab.page.locator(".span .finding").all_inner_texts())
    for name in files:
        assert name in said
    assert "error of the program" not in said
    assert case_in(folder) == before
    assert {one.name for one in folder.iterdir()} <= {
        "case.json",
        "truth.json",
        "scene.json",
        "ap.png",
        "lat.png",
        "models",
        "workbench.json",
        ".workbench-owner",
    }
    assert tab.page.locator(".finding img").count() == 0
    # The server goes on.
    tab.go("Mark")
    tab.see_xrays()


def test_a_script_in_a_label_is_words(workspace, serve, open_tab):
    folder = workspace / "demo"
    hostile = "<img src=x onerror=window.hacked=1>"
    given = case_in(folder)
    given["annotations"]["AP"][0]["label"] = hostile
    given["id"] = hostile
    (folder / "case.json").write_text(json.dumps(given))
    tab = open_tab(serve(folder).address)
    tab.go("Solve & review")
    tab.button("Solve").click()
    tab.solved()
    assert tab.page.get_by_text(hostile).count() > 0
    tab.go("Export")
    tab.button("Write the report").click()
    link = tab.page.get_by_role("link", name="Get report.html")
    with tab.page.context.expect_page() as opened:
        link.click()
    opened.value.wait_for_load_state()
    for page in (tab.page, opened.value):
        assert page.evaluate("window.hacked") is None
        assert page.locator("img[src=x]").count() == 0
