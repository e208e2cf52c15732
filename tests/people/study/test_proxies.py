"""A study behind real web servers, set up as docs/people.md says: prefix, HTTPS and redirects."""

import re
import shutil
import ssl
import subprocess
import time
from contextlib import contextmanager

import httpx2
import pytest
from forked import ROOT

from .conftest import RATED, STUDY, hidden
from .served import Server, free_port

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="needs the program openssl"),
]

KEPT = "proxy_pass http://127.0.0.1:8000;"
NO_HOST = "proxy_set_header Host $http_host;"


def recipe(language):
    """The block of a language on the page about people that is about a web server."""
    page = (ROOT / "docs" / "people.md").read_text(encoding="utf-8")
    blocks = re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL)
    [found] = [block for block in blocks if "lab.example {" in block or "server_name" in block]
    return found


def certificate(folder):
    subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1"),
            *("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"),
            *("-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")),
        ],
        check=True,
        capture_output=True,
    )
    return ssl.create_default_context(cafile=str(folder / "cert.pem"))


@contextmanager
def running(command, port):
    """A web server, from when it answers on."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        for _ in range(600):
            assert process.poll() is None, process.stdout.read()
            try:
                httpx2.get(f"http://127.0.0.1:{port}/")
            except httpx2.ConnectError:
                time.sleep(0.1)
            except httpx2.TransportError:  # it speaks TLS
                break
            else:
                break
        yield
    finally:
        process.terminate()
        process.communicate(timeout=60)


@contextmanager
def nginx(folder, backend, port, changes):
    """Debian's nginx as one process, with the page's recipe in its configuration."""
    server = recipe("nginx")
    for old, new in {
        "listen 443 ssl": f"listen 127.0.0.1:{port} ssl",
        "server_name lab.example": "server_name localhost",
        "/etc/ssl/lab.example.pem": f"{folder}/cert.pem",
        "/etc/ssl/lab.example.key": f"{folder}/key.pem",
        **changes,
        "127.0.0.1:8000": f"127.0.0.1:{backend}",
    }.items():
        assert old in server
        server = server.replace(old, new)
    temporary = "".join(
        f"{kind}_temp_path {folder}/{kind};\n"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    (folder / "nginx.conf").write_text(
        f"daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/error.log;\n"
        f"events {{}}\nhttp {{\naccess_log {folder}/access.log;\n{temporary}{server}}}\n"
    )
    with running(["nginx", "-c", str(folder / "nginx.conf"), "-p", str(folder)], port):
        yield


@contextmanager
def caddy(folder, backend, port, changes):
    """Caddy with the page's recipe and our certificate in place of one from the Internet."""
    site = recipe("caddyfile")
    for old, new in {
        "lab.example {": f"https://localhost:{port} {{\n tls {folder}/cert.pem {folder}/key.pem",
        "127.0.0.1:8000": f"127.0.0.1:{backend}",
    }.items():
        assert old in site
        site = site.replace(old, new)
    (folder / "Caddyfile").write_text(f"{{\n admin off\n auto_https disable_redirects\n}}\n{site}")
    command = ["caddy", "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]
    with running(command, port):
        yield


@pytest.mark.parametrize(
    ("program", "changes"),
    [
        (nginx, {}),
        (nginx, {KEPT: "proxy_pass http://127.0.0.1:8000/;"}),
        (nginx, {NO_HOST: ""}),
        (caddy, {}),
    ],
    ids=["nginx", "nginx strips the prefix", "nginx drops the host", "caddy"],
)
def test_a_study_behind_a_prefix_and_https_is_whole(tmp_path, program, changes):
    if shutil.which(program.__name__) is None:
        pytest.skip(f"needs the program {program.__name__}")
    trusted, port = certificate(tmp_path), free_port()
    url = f"https://localhost:{port}"
    (tmp_path / "study.yaml").write_text(f"{STUDY}url: {url}/study/\n")
    with (
        Server(tmp_path / "study.yaml") as server,
        program(tmp_path, server.port, port, changes),
        httpx2.Client(verify=trusted, timeout=60, headers={"origin": url}) as client,
    ):
        join, researcher = server.links["for people"], server.links["for you"]
        assert join.startswith(f"{url}/study/join/")

        def follow(answer):
            assert answer.status_code == 303
            assert str(answer.next_request.url).startswith(f"{url}/study/p/")
            return client.get(answer.next_request.url)

        def send(page, **given):
            action = re.search(r'action="([^"]*)"', page.text)[1]
            return follow(client.post(f"{url}{action}", data={**hidden(page.text), **given}))

        form = {**hidden(client.get(join).text), "consent": "yes"}
        page = follow(client.post(join, data=form))
        for file in re.findall(r'(?:href|src)="([^"]*)"', page.text):
            assert client.get(f"{url}{file}").status_code == 200
        page = send(page, text="city=philly")
        page = send(page, text="bye")
        assert "has ended" in page.text
        assert "Conversation 2 of 2" in send(page, **RATED).text
        for path in (researcher, f"{researcher}/"):
            answer = client.get(path, follow_redirects=True)
            assert (answer.status_code, str(answer.url)[:5]) == (200, "https")
        transcript = re.search(r'<a href="([^"]*)"', answer.text)[1]
        assert "city=philly" in client.get(f"{url}{transcript}").text
        evil = client.post(join, data=form, headers={"origin": "https://evil.example"})
        assert evil.status_code == 403
        keys = [link.rsplit("/", 1)[1] for link in (join, researcher)]
    for log in tmp_path.glob("*.log"):
        assert not any(key in log.read_text() for key in keys)
