"""`rigel muto agent`: takes commands of Muto's dashboard, Ditto and Symphony over MQTT.

serving             the loop: a message, what it asks, its answers
broker, deliveries  the connection to the broker; which messages were carried out already
address             where the broker is, and how to log in
protocols/          messages as commands, and answers as messages
contents, payloads  what the protocols have in common
components          Symphony's components as one stack
commands            the words between what is heard and what is done
wanted, memory      what must run after a command, and the Secret that remembers it
turns               one command at a time; the newest wins
allowance           what commands may use
current             the twin's `current` in Ditto
options, manifests  the agent as a Deployment

What carries commands out is an Executor, in commands/mutoagent/. Only broker, memory and current
do I/O.
"""
