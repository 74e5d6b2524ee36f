"""`rigel ui`: a release, live in a browser; joined to `rigel` by an entry point (pyproject.toml).

A page shows *entries*: values by key (`node/talker`, `topic//scan`, `revision/3`). `overview`,
`nodes` and `boxes` make them of what is on the cluster, and are pure. `live` reads the cluster by
one set of watches and gives the entries to a `Feed`, which sends each page what has changed; beside
it, it asks whether the cluster answers, and `graphs` reads the ROS graph. `logs` follows a
node's log once, however many pages show it. `readings` reads a message or
parameters when a page asks for them. `changes` carries out a rollback. `server` answers browsers,
`serving` runs it all, `cli` has the command's words, and `page/` is what the browser gets.
"""

#: The command's module, its line in the help of `rigel`, and the command that it follows there.
COMMAND = ("rigel_ui.cli", "Show a release live in the browser.", "logs")
