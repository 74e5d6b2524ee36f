"""`rigel muto agent`: takes commands of Muto's dashboard, Ditto and Symphony over MQTT.

serving             the loop: a message, the command in it, its answers
broker, deliveries  the connection to the broker; which messages were carried out already
address             where the broker is, and how to log in
protocols/          messages as commands, and answers as messages
contents, payloads  what the protocols have in common
components          Symphony's components as one stack
commands            the values between the protocols and the cluster
wanted, memory      what must run after a command, and the Secret that keeps it
turns               one command at a time; the newest wins
allowance           what commands may use
current             the twin's `current` in Ditto
options, manifests  the agent as a Deployment
probe               why its pod is not ready

An Executor, in commands/mutoagent/, carries commands out. Only broker, memory and current do I/O.
"""
