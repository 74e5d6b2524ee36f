"""Stacks and commands of Eclipse Muto: above `rigel_k8s`, which never imports this package.

What it adds to `rigel` is found by entry points (pyproject.toml): `rigel muto`, the key `muto` of
a job that deploys, and the job type muto-agent. docs/muto.md and docs/muto-agent.md explain them.

A stack is JSON that names ROS programs, parameters and remappings. It is translated into a tree of
values that a Rigelfile could contain, too, each with its place in the stack's text. Nothing here
waits, reads or calls; each module uses only those above it:

remarks.py      what to report about a value
reading.py      a text, or base64 in it, as values with places
stack.py        the model: the sections of a stack
formats.py      the forms of stacks, recognized by their keys
arguments.py    `$(arg x)`, and what only a container can resolve
parameters.py   parameters of a node or of a whole stack; a text as a number or truth
nodes.py        one node of a stack as options of a node of ours, with its lifecycle
composed.py     several nodes in one process: composable nodes and nodelets
translation.py  a stack with all that it refers to, as `nodes`
unpacking.py    an archive's files, in memory, within limits
archives.py     a stack that is an archive of sources, and the node that launches them

Where stacks come from, and who asks for them:

ditto.py        requests to a Ditto, with a secret that is sent nowhere else
opening.py      what a user names: a file, an id that files of a directory or a Ditto have, or the
                stack itself
options.py      the key `muto` as options
expansion.py    replaces the key by the stack's nodes, before anything else reads the options
convert.py      `rigel muto convert`: a whole Rigelfile as text
cli.py          the command's words
job.py          the job that deploys the agent

The agent takes commands over MQTT. agent/ decides what a message means and what is answered,
without a cluster; only broker.py, memory.py and current.py speak to others:

agent/commands.py   the values between protocols and cluster: commands, queries, outcomes
agent/payloads.py   JSON that all readers understand alike, as commands; where an answer may go
agent/protocols/    Muto's two generations and Symphony: messages as commands, outcomes as messages
agent/wanted.py     what must run after a command, as the record that outlives the agent
agent/allowance.py  what commands may use
agent/address.py    where the broker is, and how to log in
agent/broker.py     the connection to the broker, and which messages were carried out
agent/serving.py    the loop: a message, the command in it, its answers
agent/turns.py      one command at a time; the newest wins
agent/memory.py     the Secret with the record
agent/current.py    what the twin in Ditto reports
agent/options.py    the job's options; agent/manifests.py: the agent as objects of Kubernetes
agent/probe.py      why its pod is not ready

execution/ carries commands out:

execution/questions.py  answers about a ROS graph in Muto's shapes
execution/target.py     the job that commands deploy, with another stack in it
execution/executor.py   commands in, outcomes out; what is stored and announced
execution/serving.py    the program: the broker on one side, the executor on the other
"""

#: The command's module, and its line in the help of `rigel`; an entry point of this package.
COMMAND = ("rigel_muto.cli", "Use stacks of Eclipse Muto, and take its commands.")
