"""What stands before other people's Loki: it wants a user and a password, and passes the rest on.

Arguments: its own port, Loki's port, user:password.
"""

import base64
import http.client
import http.server
import sys

PORT, LOKI, LOGIN = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
WANTED = "Basic " + base64.b64encode(LOGIN.encode()).decode()


class Gateway(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        if self.headers.get("Authorization") != WANTED:
            self.answer(401, b"who are you?\n")
            return
        loki = http.client.HTTPConnection("127.0.0.1", LOKI)
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        loki.request(self.command, self.path, body, dict(self.headers))
        answer = loki.getresponse()
        self.answer(answer.status, answer.read())

    do_POST = do_GET

    def answer(self, status, body):
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


http.server.ThreadingHTTPServer(("", PORT), Gateway).serve_forever()
