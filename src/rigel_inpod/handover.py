"""Decides which pod of a workload works, and lets one take over from another: the protocol, pure.

Why: two nodes of one name do everything twice, and none does nothing. So each pod has a keeper
(keeper.py); the keepers of a workload are connected to one another, and say what they are: one
works, the others wait. This module has no sockets and no clock: events and the time come in,
messages go out, and `side` does to the node's processes what is decided (rmw_notes.py).

Who works: each worker has a *term*, larger than any that it has heard of. Of two workers the
smaller term stops. If no one works, the youngest waiting one does. Ages travel, not times of day,
so no two clocks are compared. A younger pod takes over from an older one as soon as it is fit:

    new                      old
    take               ->
                       <-    go
    leaves goals, says what it dropped:
    goals              ->    takes those as well, then no more goals; ends what it has
                       <-    drained
    holds, says what it dropped:
    hold               ->    takes that as well, then nothing; finishes; stops
                       <-    stopped, and the newest that it has taken of each
    drops that from what it held, and works: its state says so, and the old one waits

The goals' part is left out where there are no actions. Until `stopped` the old one works; it works
again if the new one ends, falls silent or gives up. Once the new one holds, it works as well if
the old one ends or falls silent.

Versions: an update may bring another one. Keys that one of them does not have are left out, or not
read. A message that cannot be read, or is not answered three times, makes the other one *strange*:
the new one then works without the exchange, and the old one stops as soon as it hears that.
"""

LOOKS, WAITS, WORKS, LEFT = "looks", "waits", "works", "left"
WORK, WAIT, HOLD, FINISH, STOP = range(5)  # modes, as in rmw_notes.py

BEAT = 0.5  # seconds between two messages of a keeper
SILENT = 10.0  # seconds after which one that says nothing is lost: it may have no processor time
LOOK = 0.2  # seconds between looks at the own processes
SEEK = 0.05  # seconds between looks for new ones, while this keeper does not work
ALONE = 1.0  # the same, and for all else that is due, of one that works and has no other to tell
GRACE = 0.15  # seconds in which a keeper that has ended may be there again
DEFER = 1.0  # seconds for which a better candidate may begin to work
SETTLE = 1.0  # seconds that partners have to find a node, after it has found them
PAIRED = (
    5.0  # the same for those that may be new versions which wait, too: they may not find it yet
)
MATCH = 30.0  # seconds for which a fit pod waits until its nodes and partners are all there
GROWN = 5.0  # seconds after the newest topic or service for which one of the old pod's is awaited
RECENT = 2.0  # seconds since a message of one that this pod hears, and that the next must hear, too
#: Seconds in which the old node, which still works, takes what the new one dropped: at most, and as
#: long as it takes nothing at all.
CATCH_UP, STANDS = 60.0, 5.0
STEP = 1.0  # seconds for a step of the old node in which it does not work: to finish
ANSWER = 10.0  # seconds until an answer that takes the other side such steps
UNANSWERED = 3  # times that a keeper does not answer, after which it is of another version
UNREADABLE = (KeyError, TypeError, ValueError, AttributeError, OverflowError)
REST = 10.0  # seconds after a switch in which responses may still be on their way
GLANCE = 0.05  # seconds between looks at open goals
FAST = 0.001  # seconds between looks during a step


class Identity(object):
    """What a keeper is.

    Attributes:
        workload: the same for all keepers that may work for one another.
        pod: its pod, the same after a restart of the container; run: different after each.
        born: when the pod started, by the clock whose time comes with the events.
    """

    def __init__(self, workload, pod, run, born):
        self.workload, self.pod, self.run, self.born = workload, pod, run, born


class Peer(object):
    """Another keeper, as it has last described itself.

    Attributes:
        strange: its version is another one, with which nothing can be arranged.
        unanswered: how often in a row it has not answered.
    """

    def __init__(self, pod, run):
        self.strange, self.unanswered = False, 0
        self.pod, self.run, self.links, self.heard = pod, run, [], 0.0
        self.role, self.term, self.born = LOOKS, 0, 0.0
        self.alive = self.fit = self.leaving = False
        self.goals, self.matched, self.hears, self.worker = 0, None, {}, ""
        self.friends, self.others, self.nodes, self.doubled = [], [], [], 0

    def update(self, now, state):
        """Take what it says of itself, as far as it can be read."""
        self.heard = now
        try:
            self._read(now, state)
        except UNREADABLE:
            self.strange = True

    def _read(self, now, state):
        self.born = now - float(state["age"])
        self.role, self.term = str(state["role"]), int(state["term"])
        self.goals = int(state["goals"])
        self.alive, self.fit, self.leaving = (bool(state[k]) for k in ("alive", "fit", "leaving"))
        self.worker = str(state["worker"])  # a pod that it sees working
        if state["type"] == "hello":  # it is short, since it goes to strangers
            return
        self.matched = {str(key): int(count) for key, count in state["matched"].items()}
        hears = state.get("hears", {})
        self.hears = {str(key): {str(one) for one in writers} for key, writers in hears.items()}
        self.doubled = int(state.get("doubled", 0))
        names = ("friends", "others", "nodes")
        self.friends, self.others, self.nodes = ([str(one) for one in state[k]] for k in names)

    @property
    def works(self):
        """Whether it works, with a node that lives."""
        return self.role == WORKS and self.alive


class _Switch(object):
    """A take-over in which this keeper takes part."""

    def __init__(self, peer, number):
        self.peer, self.number, self.inbox, self.steps = peer, number, [], None
        self.stopped = self.lost = None  # when this side stopped, when the other one was lost
        self.wake, self.hurries, self.newest = 0.0, False, {}


class _GivesUp(Exception):
    """A step has failed; all is as before the switch."""


class Handover(object):
    """A keeper's part in the protocol.

    Attributes:
        outbox: (link, message) to send, in order; message None closes the link.
        role, term: what it is.
        hurries: whether a switch is in a step of milliseconds.
    """

    def __init__(self, identity, side, save, report, drain=300.0, term=0):
        """`save(term)` keeps a term for the next run; `report(step, line)` is for people."""
        self.me, self.side, self._drain = identity, side, drain
        self._save, self._report = save, report
        self.outbox, self.role, self.term = [], LOOKS, term
        self.peers, self._links = {}, {}
        self.alive = self.fit = False
        self._highest, self._now, self._looked = term, 0.0, False
        self._next_look = self._next_beat = self._next_seek = self._wake = 0.0
        self._friends, self._others, self._known = [], [], []
        self._fit_since = self._matched_since = self._vacant = self._rest = self._leave_by = None
        self._lost, self._problem, self._said, self._missing = "", "", None, set()
        self._switch, self._number, self._again = None, 0, 0.0
        self._size, self._grown = 0, 0.0  # topics and services of the own pod, and since when

    # ---- Events -------------------------------------------------------------------------------

    def start(self, now, works):
        """Begin; `works`: an earlier run of this keeper worked, and its node still does."""
        self._now = now
        self.side.set_hold_goals(False)
        if works and self.term:
            self.role = WORKS
            self._report("works", "works")
        else:
            self.side.set_mode(WAIT)
            self._report("starts", "looks for other pods of %s" % self.me.workload)

    def opened(self, now, link):
        """A connection is there, whoever made it."""
        self._now = now
        me = self.me
        hello = {"type": "hello", "workload": me.workload, "pod": me.pod, "run": me.run}
        self.outbox.append((link, dict(self._describe(), **hello)))

    def received(self, now, link, message):
        """A message has come; one that makes no sense ends its connection."""
        self._now = now
        try:
            if link in self._links:
                self._hear(self._links[link], message)
            elif not self._greet(link, message):
                self.outbox.append((link, None))
        except UNREADABLE:
            self.outbox.append((link, None))
            self.closed(now, link)

    def knows(self, link):
        """Whether a connection is one to another keeper of the workload."""
        return link in self._links

    def closed(self, now, link, how="ended"):
        """A connection has ended; `how`, for people: its other end may not answer any more."""
        self._now = now
        peer = self._links.pop(link, None)
        if peer is not None:
            peer.links.remove(link)
            if not peer.links:
                self._lose(peer, how)

    def looked(self, now, problem=""):
        """All addresses were tried; `problem` says why there may be pods that were not found."""
        self._now, self._looked, self._problem = now, True, problem

    def leave(self, now, seconds):
        """The pod ends: let another one take over within so many seconds, if one waits."""
        self._now = now
        self._leave_by = min(now + seconds, self._leave_by or now + seconds)

    def tick(self, now):
        """Do what is due; return the seconds until the next call, unless an event comes earlier."""
        self._now, self._wake = now, now + ALONE
        self._look()
        self._seek()
        for peer in list(self.peers.values()):
            if now - peer.heard >= SILENT:
                self._lose(peer, "does not answer")
        self._decide()
        self._advance()
        self._speak()
        due = min(self._wake, self._next_beat, self._next_look, self._next_seek)
        return max(0.0, due - now)

    # ---- Others -------------------------------------------------------------------------------

    def _greet(self, link, hello):
        """Return whether a connection's first message is one of another keeper of the workload."""
        pod, run = str(hello["pod"]), str(hello["run"])
        if (hello["type"], hello["workload"]) != ("hello", self.me.workload) or pod == self.me.pod:
            return False
        known = self.peers.get(pod)
        if known is not None and known.run != run:
            self._lose(known, "ended")
        peer = self.peers[pod] if pod in self.peers else Peer(pod, run)
        peer.update(self._now, hello)
        self._highest = max(self._highest, peer.term)
        self.peers[pod] = self._links[link] = peer
        peer.links.append(link)
        self._next_beat = self._next_look = self._next_seek = self._now
        return True

    def _hear(self, peer, message):
        kind, switch = message["type"], self._switch
        peer.heard = self._now
        if kind in ("hello", "state"):
            peer.update(self._now, message)
            self._highest = max(self._highest, peer.term)
            return
        if "number" not in message:
            return  # of another version
        number = int(message["number"])
        mine = switch is not None and switch.peer is peer
        if kind == "take":
            if mine and self.role == WORKS:  # it has begun again
                self._give_up()
            if self.role == WORKS and self._switch is None:
                self._begin(peer, number, self._give)
        elif mine and switch.number == number:
            switch.inbox.append(message)
        elif kind in ("goals", "hold"):
            self.outbox.append((peer.links[0], {"type": "no", "number": number}))

    def _lose(self, peer, how):
        for link in peer.links:
            self._links.pop(link, None)
            self.outbox.append((link, None))
        peer.links = []
        if self.peers.get(peer.pod) is peer:
            del self.peers[peer.pod]
        if peer.role == WORKS:
            self._lost = "%s %s" % (peer.pod, how)
        switch = self._switch
        if switch is not None and switch.peer is peer:
            switch.lost = self._now

    def _describe(self):
        works = self.role == WORKS
        worker = self._find_worker()
        return {
            "type": "state",
            "role": self.role,
            "term": self.term,
            "age": self._now - self.me.born,
            "alive": self.alive,
            "fit": self.fit,
            "leaving": self._leave_by is not None,
            "goals": self._count_goals() if works and self._switch else 0,
            "worker": worker.pod if worker is not None and worker.works else "",
        }

    def _state(self):
        state = dict(self._describe(), friends=self._friends, others=self._others)
        nodes, matched = self.side.survey() if self.role == WORKS else ([], {})
        doubled = self.side.doubled() if self.role == WORKS else 0
        return dict(state, nodes=nodes, matched=matched, doubled=doubled, hears=self._list_heard())

    def _list_heard(self):
        """Return whom the own node hears, without those who may share memory with it alone."""
        heard = self.side.hears(RECENT) if self.role == WORKS else {}
        inside = tuple(self.side.inside()) if heard else ()
        return {k: [one for one in ws if not one.startswith(inside)] for k, ws in heard.items()}

    def _speak(self):
        """Tell the others what is new, or that this keeper lives."""
        worker = self._find_worker()
        seen = worker is not None and (worker.pod, worker.alive)
        notes = tuple(self._friends), tuple(self._others)
        said = (self.role, self.term, self.alive, self.fit, self._leave_by, seen, notes)
        if said == self._said and self._now < self._next_beat:
            return
        self._said, self._next_beat = said, self._now + self._choose(BEAT)
        if self.peers:
            state = self._state()
            self.outbox.extend((peer.links[0], state) for peer in self.peers.values())

    def _choose(self, pause):
        """Return a pause; a longer one while nothing can happen that is urgent."""
        return ALONE if self.role == WORKS and not self.peers and not self._switch else pause

    # ---- Who works ----------------------------------------------------------------------------

    def _look(self):
        if self._now < self._next_look:
            return
        self._next_look = self._now + self._choose(LOOK)
        self.alive = self.side.alive()
        if self.role == WORKS or not self.alive or not self.side.fit():
            self.fit, self._fit_since, self._matched_since = False, None, None
            self.side.agree(self.role == WORKS)
        else:
            if self._fit_since is None:
                self._fit_since = self._now
            worker = self._find_worker()
            # Between two workers no one says who its partners are; nor does a greeting.
            known = worker is not None and (worker.matched is not None or worker.strange)
            matched = known and (worker.matched is None or self._is_matched(worker))
            self.fit = self.side.agree(matched) or (known and worker.leaving)
        if self._rest is not None and self._now >= self._rest and not self._count_goals():
            self._rest = None
            self.side.set_hold_goals(False)
            self.side.set_mode(WAIT)

    def _seek(self):
        """Note the pods' processes: what one requests of a service, its own pod answers."""
        others = sorted({one for peer in self.peers.values() for one in peer.friends})
        if others != self._others:
            self._others = others
            self.side.set_others(others)
        if self._now >= self._next_seek:
            self._next_seek = self._now + (self._choose(LOOK) if self.role == WORKS else SEEK)
            self._friends = self.side.friends()
        listed = [peer.others for peer in self.peers.values() if not peer.strange]
        known = [f for f in self._friends if all(f in others for others in listed)]
        if known != self._known:
            self._known = known
            self.side.set_known(known)

    def _is_matched(self, worker):
        """Whether its nodes and partners are all there, and have had time to find it, too."""
        now, (nodes, partners) = self._now, self.side.survey()
        if len(partners) != self._size:
            self._size, self._grown = len(partners), now
        grows = now - self._grown < GROWN and not set(worker.matched) <= set(partners)
        self._missing = self._compare(worker, nodes, partners)
        if grows or self._missing:
            self._matched_since = None
        elif self._matched_since is None:
            self._matched_since = now
        settled = self._matched_since is not None and now - self._matched_since >= SETTLE
        return settled or now - self._fit_since >= MATCH

    def _compare(self, worker, nodes, partners):
        """Return the keys of what it has, and this one has not: nodes, partners, whom it hears.

        A partner that is found may not have found this one. What arrives from it proves that. Those
        that may be doubled nodes are not awaited for long.
        """
        hears = self.side.hears(2 * RECENT)
        spare = worker.doubled if self._now - self._fit_since >= PAIRED else 0
        wanted = {k: min(n, max(1, n - spare)) for k, n in worker.matched.items()}
        few = [key for key, count in wanted.items() if partners.get(key, count) < count]
        deaf = [key for key in worker.hears if _is_deaf(worker.hears[key], hears.get(key, []))]
        return set(worker.nodes).difference(nodes).union(few, set(deaf).intersection(partners))

    def _count_goals(self):
        return sum(1 for is_open in self.side.goals().values() if is_open)

    def _find_worker(self):
        """Return the peer that works, the best if there are two; None if there is none."""
        found = [peer for peer in self.peers.values() if peer.role == WORKS]
        return max(found, key=self._rank) if found else None

    @staticmethod
    def _rank(one):
        return one.alive, one.term, one.born, one.pod

    def _decide(self):
        """Find who works, and whether that is this keeper or must become it."""
        worker = self._find_worker()
        if self.role == LEFT:
            if worker is not None and worker.works and self.side.mode == WORK:
                self.side.set_mode(STOP)
        elif self.role == WORKS:
            own = (self.alive, self.term, self.me.born, self.me.pod)
            if worker is not None and self._rank(worker) > own:
                self._stop(worker)
            elif self._leave_by is not None:
                self._go()
        elif self._leave_by is not None:
            self._say_goodbye()
        elif worker is not None and (worker.alive or not self.alive):
            self._wait(worker)
        elif any(p.worker not in ("", self.me.pod) for p in self.peers.values()):
            self._vacant, self.role = None, WAITS  # it works, and this keeper will hear so
        elif self._looked:
            self._fill()

    def _stop(self, worker):
        self._switch, self.role = None, WAITS
        self.side.set_mode(STOP)
        self._rest, self._vacant, self._again = self._now + REST, None, self._now
        self._next_look = self._now

    def _go(self):
        waiting = [peer for peer in self.peers.values() if peer.alive and peer.role == WAITS]
        if not waiting or self._now >= self._leave_by:
            self._say_goodbye()
        else:
            self._wake = min(self._wake, self._leave_by)

    def _say_goodbye(self):
        """Work no more, if another one can; else until another one does."""
        if self.role == WORKS and any(p.alive and p.role == WAITS for p in self.peers.values()):
            self.side.set_mode(STOP)
        elif self.role != WORKS and self._switch:
            self._give_up()
        self._switch, self.role = None, LEFT
        self._report("left", "leaves")

    def _wait(self, worker):
        """Another one works; take over from it if that is due."""
        self._vacant, self._lost, switch = None, "", self._switch
        self.role = WAITS
        if switch is not None:
            if switch.peer is not worker or not self.alive:
                self._give_up()
            elif worker.goals:
                goals = "a goal" if worker.goals == 1 else "%d goals" % worker.goals
                self._report("standby", "waits to take over: %s has %s" % (worker.pod, goals))
            return
        wants = worker.leaving or self.me.born > worker.born
        if wants:
            self._report("standby", "waits to take over from %s" % worker.pod)
        else:
            self._report("standby", "waits, %s works" % worker.pod)
        rivals = (p for p in self.peers.values() if p.role == WAITS and p.fit)
        best = all((p.born, p.pod) < (self.me.born, self.me.pod) for p in rivals)
        if wants and self.fit and best and self._now >= self._again:
            if worker.strange:
                line = "works, in place of %s, whose keeper is of another version of rigel: "
                line += "messages may be lost, or handled twice"
                self._work(line % worker.pod, {}, [])
                return
            self._number += 1
            self._begin(worker, self._number, self._take)

    def _fill(self):
        """No one works: be the one, unless a better one is about to."""
        if self._vacant is None:
            self._vacant = self._now
        self.role = WAITS
        grace = GRACE if self._lost.endswith("ended") else 0.0
        due = self._vacant + grace
        candidates = (p for p in self.peers.values() if p.role in (LOOKS, WAITS))
        own = (self.alive, self.me.born, self.me.pod)
        if any((p.alive, p.born, p.pod) > own for p in candidates):
            due = self._vacant + DEFER
        if self._now < due:
            self._wake = min(self._wake, due)
            return
        causes = [self._lost] if self._lost else []
        causes += [peer.pod + " leaves" for peer in self.peers.values() if peer.role == LEFT]
        causes += ["%s has no node" % p.pod for p in self.peers.values() if p.role == WORKS]
        line = ", ".join(["works"] + ["since " + cause for cause in causes[:1]])
        line += "; " + self._problem if self._problem else ""
        self._work(line, self._switch.newest if self._switch else {}, [])

    def _work(self, line, newest, goals):
        """Work from now on."""
        self._switch, self._vacant, self._rest, self._lost = None, None, None, ""
        self.role, self.fit = WORKS, False
        self.term = self._highest = max(self.term, self._highest) + 1
        self._save(self.term)  # first: a keeper that ends here must not be taken for an older one
        self.side.write_drop(newest, goals)
        self.side.set_hold_goals(False)
        self.side.set_mode(WORK)
        self._speak()
        self._report("works", line)

    # ---- A switch -----------------------------------------------------------------------------

    @property
    def hurries(self):
        """Whether a switch is in a step of milliseconds."""
        return self._switch is not None and self._switch.hurries

    def _begin(self, peer, number, steps):
        self._switch = _Switch(peer, number)
        self._switch.steps = steps(self._switch)

    def _advance(self):
        """Go on with the switch as far as possible."""
        switch = self._switch
        if switch is None:
            return
        if self._now < switch.wake and not switch.inbox and switch.lost is None:
            self._wake = min(self._wake, switch.wake)
            return
        if switch.lost is not None:  # if it is the old one, _decide goes on
            if self.role == WORKS and not self._is_back_soon(switch):
                self._give_up()
            return
        ends = [one for one in switch.inbox if one["type"] in ("no", "abort")]
        if ends:
            switch.peer.strange |= any("unread" in one for one in ends)
            self._give_up()
            return
        try:
            switch.wake = self._now + next(switch.steps)
            self._wake = min(self._wake, switch.wake)
        except StopIteration:
            pass
        except _GivesUp:
            self._give_up()
        except UNREADABLE:
            switch.peer.strange = True
            self._give_up(unread=True)

    def _is_back_soon(self, switch):
        """Whether the new one, which may work already, is given time to come back."""
        due = switch.lost + GRACE
        self._wake = min(self._wake, due)
        return switch.stopped is not None and self._now < due

    def _give_up(self, **why):
        """All is as before the switch; the old one works."""
        switch, self._switch, self._again = self._switch, None, self._now + 1.0
        self.side.set_hold_goals(False)
        self.side.set_mode(WORK if self.role == WORKS else WAIT)
        if switch.peer.links:
            self._tell(switch, "abort", **why)

    def _tell(self, switch, kind, **more):
        message = dict(more, type=kind, number=switch.number)
        self.outbox.append((switch.peer.links[0], message))

    def _answer(self, switch, kinds, seconds):
        """Wait for a message of one of these kinds."""
        end = self._now + seconds
        while True:
            while switch.inbox:
                message = switch.inbox.pop(0)
                if message["type"] in kinds:
                    switch.peer.unanswered = 0
                    return message
            if self._now >= end:
                switch.peer.unanswered += 1
                switch.peer.strange |= switch.peer.unanswered >= UNANSWERED
                raise _GivesUp()
            yield end - self._now

    def _until(self, condition, seconds=STEP, pause=FAST):
        """Wait for something; return whether it has come within these seconds."""
        end = self._now + seconds
        while not condition():
            if self._now >= end:
                return False
            yield pause
        return True

    def _catch_up(self, message):
        """Wait until the own node has taken what the new one has dropped; return whether it has."""
        begun, known, before = self._now, self.side.survey()[1], None
        dropped, inside = message["dropped"], tuple(message.get("inside", ()))
        while self._now < begun + CATCH_UP:
            newest = self.side.newest()
            if _has_taken(newest, dropped, known, inside):
                return True
            if newest != before:
                before, moved = newest, self._now
            if self._now >= moved + STANDS:
                break
            yield min(GLANCE, max(FAST, (self._now - begun) / 10))
        return False

    def _check(self, processes):
        """Give up if one of the new one's processes has ended, with what it held."""
        if self.side.identify() != processes or not self.side.fit():
            raise _GivesUp()

    def _take(self, switch):
        """The new one's steps."""
        side, processes, waited = self.side, self.side.identify(), 0.0
        missing = self._missing if not switch.peer.leaving else set()
        self._tell(switch, "take")
        answer = yield from self._answer(switch, ["go"], ANSWER)
        if answer["actions"]:
            begun = self._now
            side.set_hold_goals(True)
            yield from self._until(lambda: not side.is_taking())
            self._tell(switch, "goals", dropped=side.dropped(), inside=side.inside())
            patience = float(answer["drain"]) + ANSWER
            answer = yield from self._answer(switch, ["draining"], CATCH_UP + ANSWER)
            switch.newest = answer["newest"]  # its goals are not done twice if it ends now
            answer = yield from self._answer(switch, ["drained"], patience)
            waited = self._now - begun
        self._check(processes)
        left, begun, switch.hurries = int(answer.get("left", 0)), self._now, True
        side.set_mode(HOLD)
        yield from self._until(lambda: not side.is_taking(), STANDS)
        self._tell(switch, "hold", dropped=side.dropped(), inside=side.inside())
        answer = yield from self._answer(switch, ["stopped"], CATCH_UP + ANSWER)
        self._check(processes)
        line = "works, took over from %s in %.2f s" % (switch.peer.pod, self._now - begun)
        line += " (goals waited %.1f s)" % waited if waited >= 0.1 else ""
        line += "; gave up waiting for %d goals after %.0f s" % (left, waited) if left else ""
        line += "".join("; %s" % one for one in answer["late"])
        if missing:
            lacks = ", ".join(side.name(missing)) or "a node"
            line += "; in %.0f s it did not find all that the other one has: %s" % (MATCH, lacks)
        self._work(line, answer["newest"], answer["goals"])

    def _give(self, switch):
        """The old one's steps."""
        side, late = self.side, []

        # Queues are short: the new one holds when this one has nothing to catch up with.
        yield from self._until(side.is_idle)
        self._tell(switch, "go", actions=side.has_actions(), drain=self._drain)
        message = yield from self._answer(switch, ["goals", "hold"], ANSWER)
        if message["type"] == "goals":
            yield from self._catch_up(message)
            side.set_hold_goals(True)
            yield from self._until(lambda: not side.is_taking())
            self._tell(switch, "draining", newest=side.newest())
            end = self._now + self._drain
            while self._count_goals() or side.unanswered():
                leaves = end if self._leave_by is None else self._leave_by - 3 * STEP
                if self._now >= min(end, leaves):
                    break
                yield GLANCE
            yield from self._until(side.is_idle)
            self._tell(switch, "drained", left=self._count_goals())
            message = yield from self._answer(switch, ["hold"], ANSWER)
        begun = self._now
        if not (yield from self._catch_up(message)):
            late.append("after %.0f s it had not taken all that arrived" % (self._now - begun))
        switch.hurries = True
        side.set_mode(FINISH)
        yield from self._until(lambda: not side.is_taking(), STANDS)
        if not (yield from self._until(side.is_idle)):
            late.append("after %.0f s it was still busy" % STEP)
        side.set_mode(STOP)
        switch.stopped = self._now
        goals = sorted(side.goals())
        self._tell(switch, "stopped", newest=side.newest(), goals=goals, late=late)
        switch.hurries = False
        while True:  # the new one's state says that it works
            yield BEAT


def _is_deaf(theirs, mine):
    """Whether one of those that they hear is not heard here; "" stands for any."""
    return bool(theirs.difference(mine, [""])) and "" not in mine


def _has_taken(newest, dropped, known, inside=()):
    """Whether one has taken all that another one has dropped, of what it takes at all.

    Writers inside of the other one's pod may share memory with it, and not reach this one at all.
    """
    return all(
        newest.get(key, {}).get(writer, 0) >= number
        for key, writers in dropped.items()
        if key in known
        for writer, number in writers.items()
        if writer in newest.get(key, {}) or not writer.startswith(inside)
    )
