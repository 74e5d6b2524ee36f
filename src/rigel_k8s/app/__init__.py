"""One ROS application: its options, what is wrong with them, the objects that they become; pure.

`options` are those of a job; `checks/` finds what is wrong with them. `desired` drafts a release:
`workloads` lists its workloads, `nodes` builds those of nodes with what one option each adds
(`volumes`, `files`, `components`, `lifecycle`, `layer`, `updating`, `security`, `networkpolicy`,
`recording`, `foxglove`). `generation` is what ROS 1, ROS 2 and DDS do differently, in
`generations/`. `deploying/` asks: it prepares a deploy, and has the hooks around it.
"""
