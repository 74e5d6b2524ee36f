"""The page in a real browser: what it shows, how it is used, and that it is accessible."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from rigel_k8s.commands.logs.lines import LogLine
from rigel_k8s.errors import ClusterError
from rigel_k8s.release.types import Revision
from rigel_ui.nodes import STATES
from tests.support.axe import find_violations
from tests.support.browser import Browser, Tab, find_program, run_browser
from tests.support.manifests import RELEASE
from tests.support.page import Served, fill, measure, node, serve_page, topic

WIDE, NARROW = (1440, 900), (390, 800)
SMALLEST = 11.5  # pixels of a text that is read without effort
CAUSE = "container ros-node exited with code 3 (no device)"
ROBOT = [
    node("/lidar"),
    node("/imu", "crashed", cause=CAUSE),
    node("/slam", "starting", "edge", cause="0 of 1 ready"),
    node("/planner", "unready", "edge", cause="Readiness probe failed: no plan"),
    node("/arm", "unreachable", "arm", cause="Kubernetes cannot reach the machine arm"),
    node("/camera", "blocked", cause="image a:1 cannot be pulled"),
    node("/spare", "stopped"),
]
TOPICS = [
    topic("/scan", ["/lidar"], ["/slam", "/planner"]),
    topic("/imu/data", ["/imu"], ["/slam"]),
    topic("/map", ["/slam"], ["/planner"]),
    topic("/grasp", ["/lidar"], ["/arm"]),  # to a machine that is drawn before this one
]
#: Where the boxes are on the screen: name -> [left, top, right, bottom].
PLACES = """Object.fromEntries([...document.querySelectorAll('.box')].map((box) => {
  const r = box.querySelector('rect').getBoundingClientRect();
  return [box.dataset.box, [r.left, r.top, r.right, r.bottom]];
}))"""
START = 1_800_000_000.0  # of rates, in seconds since 1970
TITLE = "document.querySelector('#details-title').textContent"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if find_program() is None:
        pytest.skip("Chromium is not installed")
    with run_browser() as made:
        yield made


def read_log(name: str, cancel: threading.Event) -> Iterator[LogLine]:
    """Some lines of each level."""
    for number, level in enumerate(("info", "warn", "error")):
        text = f"{name} says {level} <b>{number}</b>"
        yield LogLine(name, f"{name}-1", text, time=10**18 + number, level=level)
    cancel.wait()


@pytest.fixture
def served() -> Iterator[Served]:
    with serve_page(read_log) as made:
        fill(made.feed, ROBOT, TOPICS)
        yield made


@pytest.fixture
def tab(browser: Browser, served: Served) -> Iterator[Tab]:
    made = show(browser, served)
    yield made
    complaints = made.complaints()
    made.close()
    assert complaints == []


def show(browser: Browser, served: Served, size: tuple[int, int] = WIDE) -> Tab:
    """Open the page, and wait until it shows the nodes."""
    made = browser.open()
    made.resize(*size)
    made.go(served.address)
    made.wait("document.querySelectorAll('.box').length", "nodes in the graph")
    return made


def classes(tab: Tab, name: str) -> list[str]:
    """Return the classes of a box."""
    expression = f"document.querySelector('[data-box={json.dumps(name)}]').getAttribute('class')"
    return str(tab.read(expression)).split()


def click(tab: Tab, selector: str) -> None:
    tab.read(
        f"document.querySelector({json.dumps(selector)})"
        ".dispatchEvent(new MouseEvent('click', {bubbles: true}))"
    )


def focused(tab: Tab) -> str:
    """Return what has the focus: a box's name, an id, or a tag."""
    expression = "(e => e.dataset.box || e.id || e.textContent.trim() || e.tagName)"
    return str(tab.read(f"{expression}(document.activeElement)"))


# What is shown.


def test_every_state_has_its_words_its_color_and_its_shape(tab: Tab) -> None:
    """No two states look the same, with or without colors."""
    seen = {}
    for one in ROBOT:
        name = one["name"]
        assert one["state"] in classes(tab, name)
        box = f"document.querySelector('[data-box=\"{name}\"]')"
        color = tab.read(f"getComputedStyle({box}.querySelector('rect')).stroke")
        shape = tab.read(f"{box}.querySelector('.shape').getAttribute('d')")
        words = tab.read(f"{box}.querySelector('.words').textContent").split(":")[0]
        seen[one["state"]] = (shape, words)
        assert color != "none"
    assert len(set(seen.values())) == len(seen) == 7
    assert "7 nodes" not in tab.text()
    text = tab.text()
    for one in ROBOT:
        assert one["cause"] in text, "the list has the whole cause"


def test_a_crash_turns_a_node_red_and_moves_nothing(tab: Tab, served: Served) -> None:
    """The list, the title and the screen reader have it, too."""
    before = tab.read(PLACES)
    crashed = [node("/lidar", "crashed", cause="exited with code 1"), *ROBOT[1:]]
    fill(served.feed, crashed, TOPICS)
    tab.wait("document.querySelector('[data-box=\"/lidar\"].crashed')", "a crashed node")
    color = tab.read(
        "(s => s.match(/\\d+/g).map(Number))(getComputedStyle(document"
        ".querySelector('[data-box=\"/lidar\"] .shape')).stroke)"
    )
    assert color[0] > 150 > color[1], "it is red"
    assert tab.read(PLACES) == before
    first = tab.read("document.querySelector('#nodes tr').innerText")
    assert "crashed" in first
    tab.wait("document.title.startsWith('✖ 4')", "the title")
    said = tab.read("document.querySelector('#announcer').textContent")
    assert said == "/lidar is crashed: exited with code 1"


def test_the_whole_graph_is_in_its_frame(tab: Tab) -> None:
    """Edges that lead back around other boxes are not cut off."""
    outside = tab.read("""(() => {
      const frame = document.querySelector('#graph svg').getBoundingClientRect();
      return [...document.querySelectorAll('.edge')].map((e) => e.getBoundingClientRect()).filter(
        (r) => r.right > frame.right || r.bottom > frame.bottom || r.left < frame.left
      ).length;
    })()""")
    assert outside == 0


#: For each edge: its ends, and what it runs behind, by points of its path on the screen.
CROSSINGS = """[...document.querySelectorAll('.edge')].flatMap((edge) => {
  const matrix = edge.getScreenCTM();
  const length = edge.getTotalLength();
  const points = Array.from({length: 400},
    (_, i) => edge.getPointAtLength(length * i / 399).matrixTransform(matrix));
  return [...document.querySelectorAll('.box, .topic')].filter((item) => {
    const name = item.dataset.box ? `node ${item.dataset.box}` : `topic ${item.dataset.topic}`;
    if (name === edge.dataset.from || name === edge.dataset.to) return false;
    const r = item.querySelector('rect').getBoundingClientRect();
    const [left, top, right, bottom] = [r.left + 1, r.top + 1, r.right - 1, r.bottom - 1];
    return points.some((p) => p.x > left && p.x < right && p.y > top && p.y < bottom);
  }).map((item) => [edge.dataset.from, edge.dataset.to, item.dataset.box ?? item.dataset.topic]);
})"""
BOT = [
    node("/bot/driver", machine="edge"),
    node("/bot/filter", machine="robot"),
    node("/bot/planner", machine="edge"),
    node("/bot/monitor", machine="robot"),
    node("/bot/recorder", machine="edge"),
]
BOT_TOPICS = [
    topic("/bot/odom_raw", ["/bot/driver"], ["/bot/filter", "/bot/recorder"]),
    topic("/bot/odom", ["/bot/filter"], ["/bot/planner", "/bot/monitor", "/bot/recorder"]),
    topic("/bot/cmd_vel", ["/bot/planner"], ["/bot/driver", "/bot/monitor", "/bot/recorder"]),
    topic("/bot/status", ["/bot/monitor"], ["/bot/recorder"]),
]


@pytest.mark.parametrize("size", [(1400, 900), (1900, 1000), (390, 844)])
@pytest.mark.parametrize("robot", [(BOT, BOT_TOPICS), (ROBOT, TOPICS)])
def test_no_line_runs_behind_a_box(browser: Browser, size: tuple[int, int], robot: Any) -> None:
    """It would seem to end at that box. And five nodes are shown whole, from the start."""
    with serve_page() as served:
        fill(served.feed, *robot)
        tab = show(browser, served, size)
        edges = "document.querySelectorAll('.edge').length"
        assert tab.read(edges) == sum(len(t["from"]) + len(t["to"]) for t in robot[1])
        assert tab.read(CROSSINGS) == []
        for narrower in (0, 40) if robot[0] is BOT else ():
            tab.resize(size[0] - narrower, size[1])
            tab.wait(
                "(g => g.scrollWidth <= g.clientWidth && g.scrollHeight <= g.clientHeight)"
                "(document.querySelector('#graph'))",
                "the whole graph in its frame",
            )
        assert tab.complaints() == []
        tab.close()


def test_pointing_fades_no_state_that_needs_a_look(tab: Tab) -> None:
    """Nor a topic with a problem."""
    tab.read("document.querySelector('[data-box=\"/spare\"]').focus()")
    faded = tab.read("""[...document.querySelectorAll('.box')].filter(
        (box) => getComputedStyle(box).opacity < 1).map((box) => box.dataset.box)""")
    assert faded == ["/lidar"]


def test_the_list_has_room_for_causes(tab: Tab) -> None:
    """Images are in the cards only: they are long, and the same in most rows."""
    columns = "[...document.querySelectorAll('thead th')]"
    names = tab.read(f"{columns}.map((column) => column.textContent)")
    assert names == ["State", "Node", "Machine", "Ready", "Restarts", "Cause"]
    *others, cause = tab.read(f"{columns}.map((column) => column.clientWidth)")
    assert cause > 2 * max(others)
    click(tab, "[data-box='/imu']")
    assert "registry.example/robot:1.4" in tab.read("document.querySelector('#details').innerText")


def test_a_line_of_the_log_has_its_time_once(browser: Browser) -> None:
    """ROS writes it into the text as well, which is left out."""
    texts = {
        "[INFO] [1795546724.178456]: driver is up": "INFO driver is up",
        "[ WARN] [1795546724.178456789]: no scan": "WARN no scan",
        "[INFO] [1795546724.178456789] [bot.driver]: up": "INFO bot.driver: up",
        "[INFO] [1795546724.1, 12.5]: simulated": "[INFO] [1795546724.1, 12.5]: simulated",
        "[1795546724.178] a line of another kind": "[1795546724.178] a line of another kind",
    }

    def read(name: str, cancel: threading.Event) -> Iterator[LogLine]:
        yield from (LogLine(name, "p", text, time=1795546724 * 10**9) for text in texts)
        cancel.wait()

    with serve_page(read) as served:
        fill(served.feed, ROBOT)
        tab = show(browser, served)
        click(tab, ".box")
        tab.wait("document.querySelectorAll('#log .line').length === 5", "the log")
        shown = tab.read(
            "[...document.querySelectorAll('#log .line')].map((line) => line.lastChild.data)"
        )
        assert shown == list(texts.values())
        tab.close()


@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_the_head_moves_nothing(browser: Browser, size: tuple[int, int]) -> None:
    """A box stays under the pointer while a roll-out, more states, a loss or a rollback begins."""
    with serve_page() as served:
        fill(served.feed, [node("/lidar")])
        tab = show(browser, served, size)
        before = tab.read(PLACES)
        counts = dict.fromkeys(STATES, 10)
        whole = {**served.feed.get("release"), "status": "pending", "changing": "a@b, process 1"}
        served.feed.publish("release", {"release": {**whole, "counts": counts}})
        away = {**served.feed.get("cluster"), "message": "the cluster does not answer"}
        served.feed.publish("cluster", {"cluster": away})
        lines = {"to": 1, "state": "failed", "message": "it failed", "lines": ["one", "two"]}
        served.feed.publish("change", {"change": lines})
        tab.wait("!document.querySelector('#change').hidden", "the rollback")
        tab.wait("!document.querySelector('#rollout').hidden", "the roll-out")
        assert tab.read(PLACES) == before
        cut = """(part => part.scrollWidth > part.clientWidth)(document.querySelector('#counts'))"""
        assert not tab.read(cut), "shapes and numbers have room where words have none"
        assert [p["name"] for p in tab.tree() if p["name"] == "machine unreachable"]
        banner = "document.querySelector('#banner').getBoundingClientRect()"
        assert tab.read(f"{banner}.bottom <= innerHeight && {banner}.height > 0"), "it is in sight"
        tab.close()


def test_a_topic_has_a_card_with_its_rate(browser: Browser, tab: Tab, served: Served) -> None:
    """Gaps are gaps: a reading without a rate, and a time without a reading; a new page has it.

    Readings that take long are no gap.
    """
    times = [0.0, 80.0, 110.0, 140.0, 170.0, 200.0, 350.0]
    rates = [10.0, 9.5, None, 4.0, None, 10.0, 10.0]
    old = {START - 900: 99.0}  # before the plot begins
    measure(served.feed, "/scan", old | dict(zip([START + t for t in times], rates, strict=True)))
    click(tab, "[data-topic='/scan']")
    later = browser.open()
    later.go(tab.read("location.href"))
    for page in (tab, later):
        page.wait(f"{TITLE} === '/scan'", "the card")
        page.wait("document.querySelector('.plot')", "the plot")
        runs = page.read(
            "[...document.querySelectorAll('.plot polyline')]"
            ".map((line) => [...line.points].map((point) => [point.x, point.y]))"
        )
        assert [len(run) for run in runs] == [2, 1, 1, 1]
        [high, lower], [lowest], _, [newest] = runs
        assert high[1] < lower[1] < lowest[1], "y grows downwards"
        assert high[0] < lower[0] < lowest[0] < newest[0]
        assert page.read("document.querySelectorAll('.plot circle').length") == 5
        label = page.read("document.querySelector('.plot').getAttribute('aria-label')")
        assert label.endswith(": 4.0/s to 10.0/s, with 3 gaps")
        card = page.read("document.querySelector('#details').innerText")
        for words in ("std_msgs/msg/String", "/lidar", "/slam", "/planner"):
            assert words in card
    later.close()


def test_a_topic_without_a_rate_has_no_plot(tab: Tab, served: Served) -> None:
    """And the one that was chosen may leave the graph."""
    click(tab, "[data-topic='/scan']")
    tab.wait("document.querySelector('#details .note')", "a note")
    assert "No rate has been measured in the last minutes." in tab.text()
    fill(served.feed, ROBOT, TOPICS[1:])
    tab.wait(
        "document.querySelector('#details').innerText.includes('not in the ROS graph')", "its end"
    )


def test_cards_lead_to_each_other_by_keys(tab: Tab, served: Served) -> None:
    """From a node to its topic, and to the subscriber; the focus follows, and readings keep it."""
    tab.read("document.querySelector('[data-box=\"/lidar\"]').focus()")
    tab.press("Enter")
    tab.wait(f"{TITLE} === '/lidar'", "the node")
    tab.read("document.querySelector('#details [data-keep=\"topic /scan\"]').focus()")
    tab.press("Enter")
    assert (tab.read(TITLE), focused(tab)) == ("/scan", "details-title")
    assert tab.read("document.querySelector('.topic.chosen').dataset.topic") == "/scan"
    tab.press("Tab", "Tab")
    assert focused(tab) == "/slam"
    measure(served.feed, "/scan", {START: 1.0})
    tab.wait("document.querySelector('.plot')", "the plot")
    assert focused(tab) == "/slam"
    tab.press("Enter")
    assert (tab.read(TITLE), focused(tab)) == ("/slam", "details-title")
    assert tab.read("document.querySelectorAll('.topic.chosen').length") == 0


def test_a_node_has_services_and_commands_to_copy(tab: Tab, served: Served) -> None:
    """What is copied is the command."""
    box = served.feed.get("box//lidar")
    boxes = served.feed.list_group("box")
    services = [{"name": "/reset", "type": "std_srvs/srv/Empty"}]
    served.feed.publish("box", boxes | {"box//lidar": {**box, "services": services}})
    click(tab, "[data-box='/lidar']")
    tab.wait(
        "document.querySelector('#details').innerText.includes('/reset std_srvs/srv/Empty')",
        "the service",
    )
    tab.read("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    for words in ("rigel exec -it lidar -- bash", "rigel logs -f lidar"):
        click(tab, f"[aria-label='Copy {words}']")
        tab.wait(f"window.copied === '{words}'", "the command")
    click(tab, "[data-topic='/scan']")
    click(tab, "[aria-label='Copy rigel topic echo /scan']")
    tab.wait("window.copied === 'rigel topic echo /scan'", "the command")


NOTE = "document.querySelector('#readings .note').textContent"


class Ros:
    """Messages and parameters that are read when a test allows it."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.allowed = threading.Semaphore(0)
        self.failure: ClusterError | None = None

    def read_message(self, name: str) -> dict[str, Any]:
        self.asked.append(name)
        self.allowed.acquire(timeout=60)
        if self.failure:
            raise self.failure
        text = "\n".join([f"data: {len(self.asked)} <b>", *map("- {}".format, range(100))])
        return {"text": text, "shortened": True}

    def read_parameters(self, name: str) -> dict[str, Any]:
        self.asked.append(name)
        url = "http://localhost/" + "x" * 300
        return {"rows": [] if name == "/spare" else [["rate", "2.5"], ["url", f"'{url}'"]]}

    @property
    def kinds(self) -> Any:
        return {"message": self.read_message, "parameters": self.read_parameters}


def test_a_message_is_read_when_it_is_asked_for(browser: Browser) -> None:
    """Once for each press; the next one replaces it, and nothing moves or loses its place."""
    ros = Ros()
    with serve_page(kinds=ros.kinds) as served:
        fill(served.feed, ROBOT, TOPICS)
        tab = show(browser, served)
        click(tab, "[data-topic='/scan']")
        tab.read("document.querySelector('#readings button').focus()")
        place = "document.querySelector('#readings button').getBoundingClientRect().top"
        before = tab.read(place)
        assert ros.asked == []
        for number in (1, 2):
            tab.press("Enter", "Enter")  # the second one while it is read
            tab.wait(f"{NOTE} === 'reading…'", "the state")
            ros.allowed.release()
            tab.wait(f"{NOTE}.startsWith('read at ')", "the message")
            text = tab.read("document.querySelector('#readings .area').textContent")
            assert text.startswith(f"data: {number} <b>\n- 0\n")
            assert tab.read("document.querySelectorAll('#readings .area').length") == 1
            assert (focused(tab), tab.read(place)) == ("Show a message", before)
        assert ros.asked == ["/scan", "/scan"]
        assert "Long arrays and texts are shortened." in tab.text()
        said = tab.read("document.querySelector('#announcer').textContent")
        assert said.startswith("message of /scan: read at ")
        tab.read("document.querySelector('#readings .area').scrollTop = 100")
        measure(served.feed, "/scan", {START: 1.0})
        tab.wait("document.querySelector('.plot')", "another card")
        assert tab.read("document.querySelector('#readings .area').scrollTop") == 100
        assert focused(tab) == "Show a message"
        ros.failure = ClusterError("no message came within 20 s", hint="wait longer")
        ros.allowed.release()
        tab.press("Enter")
        tab.wait(f"{NOTE} === 'failed'", "the failure")
        card = tab.read("document.querySelector('#readings').innerText")
        assert card.split("\n")[-2:] == ["no message came within 20 s", "wait longer"]
        assert tab.read("document.querySelector('#readings .area')") is None
        assert tab.complaints() == []
        tab.close()


def test_the_parameters_of_a_node_are_a_table(browser: Browser) -> None:
    """Of several nodes in one pod each has its own."""
    ros = Ros()
    with serve_page(kinds=ros.kinds) as served:
        fill(served.feed, ROBOT, TOPICS)
        boxes = served.feed.list_group("box")
        one, other = boxes["box//imu"], {**boxes["box//imu"], "name": "/imu2"}
        served.feed.publish("box", boxes | {"box//imu": one, "box//imu2": other})
        tab = show(browser, served)
        click(tab, "[data-box='/lidar']")
        click(tab, "#readings button")
        tab.wait("document.querySelector('#readings table')", "the table")
        cells = "[...document.querySelectorAll('#readings tr')].map((row) =>"
        cells += " [...row.children].map((cell) => cell.textContent.slice(0, 20)))"
        rows = [["Name", "Value"], ["rate", "2.5"], ["url", "'http://localhost/xx"]]
        assert tab.read(cells) == rows
        wide = "(e => e.scrollWidth > e.clientWidth)(document.querySelector('#readings .area'))"
        assert not tab.read(wide), "a long value has several lines"
        click(tab, "[data-box='/spare']")
        tab.wait(f"{NOTE} === ''", "another card")
        click(tab, "#readings button")
        tab.wait("document.querySelector('#readings').innerText.includes('has no')", "none")
        click(tab, "[data-box='/imu']")
        words = "[...document.querySelectorAll('#readings button')].map((b) => b.textContent)"
        assert tab.read(words) == ["Show parameters of /imu", "Show parameters of /imu2"]
        click(tab, "#readings div:last-child button")
        tab.wait("document.querySelectorAll('#readings table').length === 1", "the other's")
        assert ros.asked == ["/lidar", "/spare", "/imu2"]
        click(tab, "[data-box='/lidar']")
        assert tab.read(cells) == rows, "the card has kept what was read"
        assert tab.complaints() == []
        tab.close()


def test_a_rollout_shows_its_progress(tab: Tab, served: Served) -> None:
    """Who makes it and how far it is; afterwards it is gone."""
    assert tab.read("document.querySelector('#rollout').hidden")
    whole = {**served.feed.get("release"), "status": "pending", "changing": "a@b, process 1"}
    served.feed.publish("release", {"release": {**whole, "ready": 5}})
    tab.wait("!document.querySelector('#rollout').hidden", "the roll-out")
    assert "5 of 7 nodes are ready, rolled out by a@b, process 1" in tab.text()
    assert tab.read("document.querySelector('#rollout-bar').value") == 5
    served.feed.publish("release", {"release": {**whole, "changing": ""}})
    tab.wait("document.querySelector('#rollout').hidden", "the end of the roll-out")
    assert "Revision 2, interrupted" in tab.text()


def test_hostile_texts_are_shown_as_texts(browser: Browser) -> None:
    """Whatever a cluster says, nothing of it becomes a part of the page."""
    bad = "<img src=x onerror='document.title=1'><script>document.title=2</script>\"'&amp;"
    kinds: Any = {"message": lambda name: {"text": name + bad, "shortened": False}}
    with serve_page(lambda name, cancel: iter([LogLine("w", "p", bad)]), kinds=kinds) as served:
        hostile = node(f"/{bad}", "crashed", bad, bad, workload="w", remedy=bad, image=bad)
        fill(served.feed, [hostile], [topic(f"/t{bad}", [f"/{bad}"], [])])
        served.feed.publish("problems", {"problems": [{"message": bad, "severity": "error"}]})
        revision = {"number": 1, "status": bad, "created": bad, "description": bad}
        served.feed.publish(
            "revision", {"revision/1": {**revision, "changes": [bad], "back": [bad]}}
        )
        served.feed.publish("graph", {"graph": {"message": bad, "read": bad}})
        tab = show(browser, served)
        click(tab, ".box")
        tab.wait("document.querySelector('#log').textContent", "the log")
        assert tab.text().count(bad) >= 7
        click(tab, ".topic")
        tab.wait(f"{TITLE}.startsWith('/t<img')", "the card of the topic")
        assert "rigel topic" not in tab.text(), "a shell would interpret this name"
        click(tab, "#readings button")
        tab.wait("document.querySelector('#readings .area')", "the message")
        read = tab.read("document.querySelector('#readings .area').textContent")
        assert read == f"/t{bad}{bad}"
        assert tab.read("document.querySelectorAll('img, script:not([src])').length") == 0
        assert not tab.read("document.title").isdigit()
        assert tab.complaints() == []
        tab.close()


def test_nothing_is_loaded_from_elsewhere(tab: Tab, served: Served) -> None:
    """Neither a font nor a script; and the page's own server gets every request."""
    asked = tab.requests()
    assert len(asked) > 10
    assert {address.startswith(served.address) for address in asked} == {True}


@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_a_hundred_nodes_stay_readable(browser: Browser, size: tuple[int, int]) -> None:
    """No box covers another, no name is cut, and all texts are as large as with ten nodes."""
    nodes = [node(f"/unit_{i % 10}/node_{i:03}", machine=f"machine-{i // 10}") for i in range(100)]
    names = [one["name"] for one in nodes]
    topics = [
        topic(f"/topic_{i:03}", [name], [names[(i * 7 + 3) % 100], names[(i + 1) % 100]])
        for i, name in enumerate(names)
    ]
    with serve_page() as served:
        fill(served.feed, nodes, topics)
        tab = show(browser, served, size)
        places = tab.read(PLACES)
        assert len(places) == 100
        assert overlaps(list(places.values())) == []
        factor = tab.read(
            "(s => s.getBoundingClientRect().width / s.viewBox.baseVal.width)"
            "(document.querySelector('#graph svg'))"
        )
        sizes = tab.read(
            "[...document.querySelectorAll('.box text, .machine text')]"
            ".map((t) => parseFloat(getComputedStyle(t).fontSize))"
        )
        assert min(sizes) * factor >= SMALLEST * 0.88
        shown = tab.read(
            "[...document.querySelectorAll('.box .name')].map((t) => t.textContent.trim())"
        )
        assert sorted(shown) == sorted(names)
        cut = tab.read("""[...document.querySelectorAll('.box')].filter((box) => {
          const outer = box.querySelector('rect').getBoundingClientRect();
          return [...box.querySelectorAll('text')].some((text) =>
            text.getBoundingClientRect().right > outer.right + 1);
        }).map((box) => box.dataset.box)""")
        assert cut == []
        page = tab.read("[document.documentElement.scrollWidth, innerWidth]")
        assert page[0] <= page[1], "the page itself does not scroll sideways"
        tab.read("document.querySelector('#find').focus()")
        tab.type("node_042")
        tab.wait("document.querySelectorAll('#nodes tr').length === 1", "the node that was found")
        assert tab.complaints() == []
        tab.close()


def test_any_name_has_its_box_and_its_lines(browser: Browser) -> None:
    """A ROS master takes every name; Graphviz has signs that mean something else."""
    names = [
        "/a\nb",
        "/c\\d",
        "/e\\nf",
        '/g"h',
        "/i\\",
        "/l&amp;m",
        "/q\r\nz",
        "/x\x07y",
        "/%41",
        "/ü",
    ]
    topics = [topic(f"{name}/t", [name], [names[0]]) for name in names]
    with serve_page() as served:
        fill(served.feed, [node(name) for name in names], topics)
        tab = show(browser, served)
        shown = tab.read("[...document.querySelectorAll('.box')].map((e) => e.dataset.box)")
        assert sorted(shown) == sorted(names)
        assert tab.read("document.querySelectorAll('.topic').length") == len(topics)
        assert tab.read("document.querySelectorAll('.edge').length") == 2 * len(topics)
        assert tab.complaints() == []
        tab.close()


def test_the_card_of_what_was_clicked_is_in_view(browser: Browser) -> None:
    """Where the parts are below each other, too: it is next to the graph."""
    robot = [node(f"/node_{i}") for i in range(18)]
    with serve_page() as served:
        fill(served.feed, robot)
        tab = show(browser, served, (800, 700))
        for name in ("/node_3", "/node_11"):
            click(tab, f"[data-box='{name}']")
            tab.wait(f"{TITLE} === '{name}'", "the card")
            place = "document.querySelector('#details').getBoundingClientRect()"
            assert tab.read(f"{place}.top >= 0 && {place}.bottom <= innerHeight")
            last = "document.querySelector('#graph').getBoundingClientRect().bottom"
            assert tab.read(f"{last} > 0"), "a part of the graph is still there"
        tab.close()


def test_what_is_not_in_view_is_counted(browser: Browser) -> None:
    """A graph that would be too small to read is cut; one that is shown whole needs no words."""
    view = "document.querySelector('#graph-view').textContent"
    with serve_page() as served:
        fill(served.feed, [node(f"/node_{i}", machine=f"m{i}") for i in range(40)])
        tab = show(browser, served)
        tab.wait(f"/^[1-9]\\d* of 40 nodes are in view$/.test({view})", "the number")
        before = tab.read(view)
        tab.read("document.querySelector('#graph').scrollTo(9999, 9999)")
        tab.wait(f"{view} !== {json.dumps(before)}", "another number")
        click(tab, "#zoom-fit")
        tab.wait(f"{view} === ''", "all of it")
        tab.close()


def overlaps(places: list[list[float]]) -> list[Any]:
    """Return the pairs of places that cover each other."""
    return [
        (a, b)
        for i, a in enumerate(places)
        for b in places[i + 1 :]
        if a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
    ]


def test_ten_pages_in_one_browser_are_all_live(browser: Browser, served: Served) -> None:
    """A browser opens at most six HTTP/1.1 connections to a server; pages behind hold none."""
    tabs = []
    for _ in range(10):
        tabs.append(show(browser, served))
        tabs[-1].show()
        for behind in tabs[:-1]:
            behind.wait("document.hidden", "the page to be behind")
    fill(served.feed, [node("/lidar", "crashed"), *ROBOT[1:]], TOPICS)
    for tab in tabs:
        tab.wait("document.querySelector('[data-box=\"/lidar\"].crashed')", "the change")
    for tab in tabs:
        tab.close()


def test_a_lost_server_is_reported_and_found_again(browser: Browser) -> None:
    """The page stays, says so, and goes on when `rigel ui` is there again."""
    with serve_page() as served:
        fill(served.feed, ROBOT)
        tab = show(browser, served)
        port = served.port
    tab.wait("document.body.classList.contains('lost')", "the loss")
    assert "No connection to rigel ui" in tab.text()
    assert tab.read("document.querySelectorAll('.box').length") == 7
    with serve_page(port=port) as served:
        fill(served.feed, ROBOT[:1])
        tab.wait("document.querySelectorAll('.box').length === 1", "the page to be live again")
        assert "No connection to rigel ui" not in tab.text()
        tab.close()


def test_a_lost_cluster_is_reported(tab: Tab, served: Served) -> None:
    """What is shown stays, without its colours, and the page says of when it is."""
    color = "getComputedStyle(document.querySelector('#counts')).filter"
    assert tab.read(color) == "none"
    place = served.feed.get("cluster")
    away = {**place, "message": "the cluster does not answer", "since": "2026-01-01T10:00:00Z"}
    served.feed.publish("cluster", {"cluster": away})
    tab.wait("document.querySelector('#banner').textContent", "the banner")
    assert "the cluster does not answer. What this page shows is of" in tab.text()
    assert tab.read(color) == "grayscale(1)", "nothing looks as if all were well"
    assert tab.read("document.querySelectorAll('.box').length") == 7
    served.feed.publish("cluster", {"cluster": place})
    tab.wait("!document.querySelector('#banner').textContent", "the end of the banner")
    assert tab.read(color) == "none"


def test_the_log_of_a_node_is_followed(tab: Tab) -> None:
    """By level and text; a pause keeps what comes. Before, there is no empty box."""
    assert tab.read("document.querySelector('#log').hidden")
    click(tab, "[data-box='/imu']")
    lines = "[...document.querySelectorAll('#log .line')].filter(l => !l.hidden).length"
    tab.wait(f"{lines} === 3", "the lines")
    assert "imu says error <b>2</b>" in tab.text()
    tab.read("(s => { s.value = 'warn'; s.dispatchEvent(new Event('change')); })"
             "(document.querySelector('#level'))")  # fmt: skip
    assert tab.read(lines) == 2
    tab.read("document.querySelector('#filter').focus()")
    tab.type("ERROR")
    assert tab.read(lines) == 1
    click(tab, "#pause")
    click(tab, "[data-box='/lidar']")
    tab.wait(
        "document.querySelector('#log-note').textContent === 'Paused: 3 new lines.'", "the pause"
    )
    click(tab, "#pause")
    tab.wait(f"{lines} === 1", "the lines that were held")


def test_a_hidden_page_draws_its_log_when_it_is_shown(browser: Browser, served: Served) -> None:
    """Ten pages in the background must not cost a core while a node talks."""
    hidden = show(browser, served)
    front = show(browser, served)
    front.show()
    hidden.wait("document.hidden", "the page to be hidden")
    for tab in (hidden, front):
        click(tab, "[data-box='/imu']")
    lines = "document.querySelectorAll('#log .line').length === 3"
    front.wait(lines, "the log in the page in front")
    assert not hidden.read(lines)
    hidden.show()
    hidden.wait(lines, "the log that was held")
    hidden.close()
    front.close()


# Keys and screen readers.


def test_the_keyboard_reaches_everything(tab: Tab) -> None:
    """Tab goes through the parts, arrow keys from node to node, Enter chooses."""
    tab.press("Tab")
    assert focused(tab) == "Skip to the list of nodes"
    order = []
    for _ in range(6):
        tab.press("Tab")
        order.append(focused(tab))
    assert order == ["find", "zoom-out", "zoom-fit", "zoom-in", "graph", "/arm"]
    place = (
        "(r => [r.left, r.top])"
        "(document.activeElement.querySelector('rect').getBoundingClientRect())"
    )
    visited = set()
    for key in ("Home", "ArrowRight", "ArrowDown", "ArrowDown", "ArrowLeft", "ArrowUp", "End"):
        before, left = tab.read(place), tab.read("document.activeElement.dataset.item")
        tab.press(key)
        now = tab.read("document.activeElement.dataset.item")
        visited.add(now.partition(" ")[0])
        if key == "ArrowDown" and now != left:
            assert tab.read(place)[1] > before[1]
    assert focused(tab) == "/spare"
    assert visited == {"node", "topic"}
    tab.press("Enter")
    tab.wait("document.querySelector('#details-title').textContent === '/spare'", "the details")
    assert focused(tab) == "/spare"
    tab.press("Shift+Tab")
    assert focused(tab) == "graph"


def test_the_focus_stays_when_something_changes(tab: Tab, served: Served) -> None:
    """A node that comes or goes does not take it away."""
    tab.read("document.querySelector('[data-box=\"/imu\"]').focus()")
    fill(served.feed, [*ROBOT, node("/new")], TOPICS)
    tab.wait("document.querySelector('[data-box=\"/new\"]')", "the new node")
    assert focused(tab) == "/imu"


def test_a_screen_reader_gets_names_states_and_causes(tab: Tab) -> None:
    """Of each node: what the picture shows by place, color and lines is in its name."""
    parts = tab.tree()
    buttons = [part["name"] for part in parts if part["role"] == "button"]
    whole = f"/imu crashed, {CAUSE}, on robot, publishes /imu/data"
    assert whole in buttons
    slam = "/slam starting, 0 of 1 ready, on edge, publishes /map, subscribes to /imu/data /scan"
    assert slam in buttons
    scan = "/scan 10.0/s, topic of type std_msgs/msg/String, from /lidar, to /slam /planner"
    assert scan in buttons
    headings = [part["name"] for part in parts if part["role"] == "heading"]
    assert headings == ["demo", "ROS graph", "Nodes", "Node", "Log", "History"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_axe_finds_nothing_serious(browser: Browser, scheme: str, size: tuple[int, int]) -> None:
    """With everything that a page can show: a roll-out, problems, a log, a rollback, a dialog."""
    ros = Ros()
    with serve_page(
        read_log, rollback=lambda *_: Revision(RELEASE, 4, "good", "", (), ()), kinds=ros.kinds
    ) as served:
        fill(served.feed, ROBOT, TOPICS, changes=True)
        publish_more(served)
        tab = show(browser, served, size)
        tab.prefer(scheme)
        click(tab, "[data-box='/imu']")
        tab.wait("document.querySelectorAll('#log .line').length === 3", "the log")
        tab.wait("!document.querySelector('#change').hidden", "the rollback")
        click(tab, "#readings button")
        tab.wait("document.querySelector('#readings table')", "the parameters")
        assert find_violations(tab) == []
        measure(served.feed, "/scan", {START: 1.0, START + 30: 2.0})
        click(tab, "[data-topic='/scan']")
        tab.wait("document.querySelector('.plot')", "the plot")
        click(tab, "#readings button")
        tab.wait(f"{NOTE} === 'reading…'", "the state")
        assert find_violations(tab) == []
        ros.allowed.release()
        tab.wait("document.querySelector('#readings .area')", "the message")
        assert find_violations(tab) == []
        click(tab, "#history button")
        assert find_violations(tab) == []
        tab.close()


def publish_more(served: Served) -> None:
    feed = served.feed
    whole = {**feed.get("release"), "status": "pending", "changing": "me"}
    feed.publish("release", {"release": whole})
    feed.publish("cluster", {"cluster": {**feed.get("cluster"), "message": "away", "since": ""}})
    problems = [{"message": "wrong", "severity": "error"}, {"message": "doubtful"}]
    feed.publish("problems", {"problems": problems})
    lines = {"to": 1, "state": "failed", "message": "it failed", "lines": ["one", "two"]}
    feed.publish("change", {"change": lines})
    feed.publish("revision", {f"revision/{n}": revision(n) for n in (1, 2)})


def revision(number: int) -> dict[str, Any]:
    return {
        "number": number,
        "status": "good",
        "created": "2026-01-01T00:00:00Z",
        "description": "an update",
        "changes": [f"/lidar: image a:{number - 1} to a:{number}"],
        "back": [] if number == 2 else ["/lidar: image a:2 to a:1"],
    }


# Changes.


def test_a_page_that_may_not_change_anything_offers_nothing(tab: Tab, served: Served) -> None:
    """It says how to allow it."""
    served.feed.publish("revision", {f"revision/{n}": revision(n) for n in (1, 2)})
    tab.wait("document.querySelectorAll('#history > li').length === 2", "the history")
    assert tab.read("document.querySelectorAll('#history button').length") == 0
    assert "--allow-changes" in tab.text()


def ask_nothing(number: int, report: Any, cancel: threading.Event) -> Revision:
    raise AssertionError(f"no one has asked for revision {number}")


def test_a_revision_that_was_never_good_looks_different(browser: Browser) -> None:
    """In words as well as in its border; a killed deploy was interrupted."""
    states = {1: "failed", 2: "interrupted", 3: "pending", 4: "superseded", 5: "good", 6: "pending"}
    with serve_page(rollback=ask_nothing) as served:
        fill(served.feed, ROBOT, changes=True)
        whole = {**served.feed.get("release"), "status": "pending", "revision": 6}
        served.feed.publish("release", {"release": {**whole, "changing": "me"}})
        known = {f"revision/{n}": {**revision(n), "status": s} for n, s in states.items()}
        served.feed.publish("revision", known)
        tab = show(browser, served)
        tab.wait("document.querySelectorAll('#history > li').length === 6", "the history")
        read = "[...document.querySelectorAll('#history %s')].map((e) => %s)"
        lines = tab.read(read % ("strong", "e.nextSibling.textContent"))
        words = ["pending", "good", "superseded", "interrupted", "interrupted", "failed"]
        assert [line.strip(" ,") for line in lines] == words
        found = tab.read(read % ("button", "[e.textContent, getComputedStyle(e).borderStyle]"))
        assert found == [
            ["Roll back to revision 5…", "solid"],
            ["Roll back to revision 4…", "solid"],
            ["Roll back to revision 3, which was interrupted…", "dashed"],
            ["Roll back to revision 2, which was interrupted…", "dashed"],
            ["Roll back to revision 1, which has failed…", "dashed"],
        ]
        click(tab, "#history .doubtful")
        title = tab.read("document.querySelector('#confirm-title').textContent")
        assert title == "Roll back to revision 3, which was interrupted?"
        tab.close()


def test_a_rollback_is_confirmed(browser: Browser) -> None:
    """The dialog says what would change; Cancel and Escape do nothing."""
    rolled: list[int] = []

    def rollback(number: int, report: Any, cancel: threading.Event) -> Revision:
        rolled.append(number)
        return Revision(RELEASE, 3, "good", "", (), (), description="rollback to revision 1")

    with serve_page(rollback=rollback) as served:
        fill(served.feed, ROBOT, changes=True)
        served.feed.publish("revision", {f"revision/{n}": revision(n) for n in (1, 2)})
        tab = show(browser, served)
        tab.wait("document.querySelector('#history button')", "the history")
        assert tab.read("document.querySelectorAll('#history button').length") == 1
        for way_out in ("Escape", "Enter"):  # Cancel has the focus
            tab.read("document.querySelector('#history button').focus()")
            tab.press("Enter")
            assert tab.read("document.querySelector('dialog').open")
            assert "/lidar: image a:2 to a:1" in tab.read(
                "document.querySelector('dialog').innerText"
            )
            assert focused(tab) == "confirm-no"
            tab.press(way_out)
            tab.wait("!document.querySelector('dialog').open", "the end of the dialog")
        assert rolled == []
        tab.read("document.querySelector('#history button').focus()")
        tab.press("Enter", "Tab", "Enter")
        tab.wait("document.querySelector('#change-text').textContent.startsWith('Rolled')", "it")
        assert rolled == [1]
        assert "Rolled back: revision 3: rollback to revision 1" in tab.text()
        later = show(browser, served)
        later.wait("document.querySelector('#history button')", "the history")
        assert "Rolled back" not in later.text(), "it greets no one who comes later"
        later.close()
        click(tab, "#change-close")
        assert "Rolled back" not in tab.text()
        tab.close()
