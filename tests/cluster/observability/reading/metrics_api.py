"""A server of metrics.k8s.io behind the API server's aggregation, as small as one can be.

Arguments: its certificate, its key, and a JSON object of pods: what the API tells of each. What it
answers has the form of metrics-server 0.9.0's answers.
"""

import http.server
import json
import ssl
import sys
import tempfile

GROUP = "metrics.k8s.io/v1beta1"
PODS = json.loads(sys.argv[3])


def resources():
    pods = {"name": "pods", "singularName": "", "namespaced": True, "kind": "PodMetrics"}
    pods["verbs"] = ["get", "list"]
    return {
        "kind": "APIResourceList",
        "apiVersion": "v1",
        "groupVersion": GROUP,
        "resources": [pods],
    }


def metrics(namespace):
    items = [
        {
            "metadata": {"name": name, "namespace": namespace},
            "timestamp": "2026-01-01T00:00:00Z",
            "window": "15.011s",
            "containers": [{"name": "ros-node", "usage": usage}],
        }
        for name, usage in PODS.items()
    ]
    return {"kind": "PodMetricsList", "apiVersion": GROUP, "metadata": {}, "items": items}


class Api(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        words = self.path.partition("?")[0].strip("/").split("/")
        found = None
        if words == ["apis", *GROUP.split("/")]:
            found = resources()
        elif words[3:4] == ["namespaces"] and words[5:] == ["pods"]:
            found = metrics(words[4])
        body = json.dumps(found).encode()
        self.send_response(200 if found else 404)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
with tempfile.NamedTemporaryFile("w", suffix=".pem") as file:
    file.write(sys.argv[1] + sys.argv[2])
    file.flush()
    context.load_cert_chain(file.name)
server = http.server.ThreadingHTTPServer(("", 8443), Api)
server.socket = context.wrap_socket(server.socket, server_side=True)
server.serve_forever()
