"""A web server for the tests, with the faults that a page meets in the wild."""

import functools
import http.server
import threading


class Handler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass

    def do_GET(self):
        faults = {"/half/": self.half, "/foreign/": self.foreign, "/page/": self.web_page, "/slow/": self.unknown_length}
        for prefix, answer in faults.items():
            if self.path.startswith(prefix) and self.path.endswith(".safetensors"):
                return answer()
        # a server that ignores ranges, one that fails for all but the first cell, a good one
        prefix, separator, name = self.path.partition("levels/")
        separator = separator and "?" not in prefix
        if separator and prefix != "/ignores/" and "Range" in self.headers:
            return self.range(name, prefix == "/torn/")
        if separator:
            self.path = f"/levels/{name}"
        super().do_GET()

    def range(self, name, torn):
        first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
        if torn and first > 0:
            return self.send_error(503)
        with open(f"{self.directory}/levels/{name}", "rb") as file:
            body = file.read()
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{last}/{len(body)}")
        self.send_header("Content-Length", str(last + 1 - first))
        self.end_headers()
        self.wfile.write(body[first : last + 1])

    def scene(self):
        with open(f"{self.directory}/scene.safetensors", "rb") as file:
            return file.read()

    def answer(self, body, length=None):
        self.send_response(200)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()
        self.wfile.write(body)
        self.close_connection = True

    def half(self):
        scene = self.scene()
        self.answer(scene[: len(scene) // 2], len(scene))

    def foreign(self):
        self.answer(b"ply\nformat ascii 1.0\n", 21)

    def web_page(self):
        self.answer(b"<!doctype html><title>not here</title>", 38)

    def unknown_length(self):
        self.answer(self.scene())


class Server(http.server.ThreadingHTTPServer):
    def handle_error(self, *_):
        """Browsers close connections that they no longer need."""


class Site:
    """Serves `folder` at two addresses; for a page of one, the other is another site, which sends no CORS headers."""

    def __init__(self, folder):
        handler = functools.partial(Handler, directory=str(folder))
        self.servers = [Server(("127.0.0.1", 0), handler) for _ in range(2)]
        self.here, self.elsewhere = (f"http://127.0.0.1:{server.server_port}" for server in self.servers)

    def __enter__(self):
        for server in self.servers:
            threading.Thread(target=server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_):
        for server in self.servers:
            server.shutdown()
            server.server_close()
