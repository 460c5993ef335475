# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Show a report: serve it to this machine alone and open the browser."""

from __future__ import annotations

from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
import webbrowser


def make_server(page: Path) -> ThreadingHTTPServer:
    """
    Return a server of one page, on a free port of the loopback interface.

    Its address is ``http://127.0.0.1:<server.server_port>/``. The file is read at each request.
    """

    class Handler(BaseHTTPRequestHandler):
        """Answers with the page, whatever else is asked for does not exist."""

        def do_GET(self) -> None:
            """Send the page."""
            if self.path.partition('?')[0] not in ('/', f'/{page.name}'):
                self.send_error(404)
                return
            try:
                content = page.read_bytes()
            except OSError:
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header('Content-Type', 'text/html; charset=utf-8')
            self.send_header('Content-Length', str(len(content)))
            self.send_header('Cache-Control', 'no-store')
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            """Keep quiet."""

    return ThreadingHTTPServer(('127.0.0.1', 0), Handler)


def show(page: Path) -> None:
    """Serve the page and open the browser, until Ctrl-C."""
    with make_server(page) as server:
        address = f'http://127.0.0.1:{server.server_port}/'
        print(f'{page} is shown at {address} until Ctrl-C', flush=True)
        webbrowser.open(address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
