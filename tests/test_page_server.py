"""The page over HTTP, and arms that Python moves for it: what is asked by browsers, and by anyone else."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.client import HTTPConnection
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
import pytest
from PIL import Image

import reachlab
from reachlab.cli import main as cli
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.settings.validation import InputError
from reachlab.watch.page import server as server_module
from reachlab.watch.page.document import page_head
from reachlab.watch.page.episode import programs, sampled
from reachlab.watch.page.page import page_body
from reachlab.watch.page.remote import MOST_STEPS, Asked, Remote, read_asked, record
from reachlab.watch.page.server import LOCAL, MOST_BYTES, MOST_CONNECTIONS, PageServer, is_local
from reachlab.watch.page.shown import Shown

PATIENCE = 60.0

HTML = "<!doctype html>"

ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body pos="0 0 .2"><joint name="turn" axis="0 0 1" range="-2 2"/><geom size=".03" type="capsule"
fromto="0 0 0 0 0 .2"/>
<body pos="0 0 .2"><joint name="lift" axis="0 1 0" range="-2 2"/><geom size=".03" type="capsule"
fromto="0 0 0 {0} 0 0"/>
<body pos="{0} 0 0"><joint name="bend" axis="0 1 0" range="-2 2"/><geom size=".03" type="capsule"
fromto="0 0 0 {0} 0 0"/>
<site name="tool" pos="{0} 0 0"/></body></body></body></worldbody></mujoco>"""
"""An arm of links of a length [m]."""


def shown(task: str = "tutorial", **settings: Any) -> Shown:
    """A baseline in an environment, moved by Python."""
    return Shown("one", Env(configure(task, randomise=(), **settings), 1), None, "ik", why="this is a test")


@pytest.fixture(scope="module")
def arm() -> Shown:
    return shown()


@contextlib.contextmanager
def serving(*arms: Callable[[], Any]) -> Iterator[PageServer]:
    """A server of arms that a thread of its own moves."""
    over = threading.Event()
    with PageServer(LOCAL, 20_000) as server:
        thread = threading.Thread(target=server.serve, args=(arms, over.is_set))
        thread.start()
        yield server
        over.set()
        thread.join(PATIENCE)
        assert not thread.is_alive()


@pytest.fixture(scope="module")
def server(arm: Shown) -> Iterator[PageServer]:
    with serving(partial(Remote, arm)) as server:
        server.add(HTML, last=True)
        yield server


def request(
    server: PageServer, method: str = "GET", path: str = "/", body: bytes = b"", **headers: str
) -> tuple[int, bytes]:
    """Status and body of an answer."""
    port = int(server.url.rpartition(":")[2])
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    with contextlib.closing(HTTPConnection(LOCAL, port, timeout=PATIENCE)) as connection:
        connection.request(method, path, body if method == "POST" else None, given)
        answer = connection.getresponse()
        return answer.status, answer.read()


def ask(server: PageServer, page: str = "this", **asked: Any) -> dict[str, Any]:
    """What a page is told."""
    status, told = request(
        server, "POST", "/play", json.dumps(asked).encode(), Content_Type="application/json", X_Page=page
    )
    return json.loads(told) | {"status": status}


# --- what a page asks for -------------------------------------------------------------------------


def test_an_arm_is_moved_as_a_page_asks(server: PageServer, arm: Shown) -> None:
    begun = ask(server, begin=True)
    assert begun["clock"] == [0]
    there = ask(server, agent="ik", steps=10)
    assert there["clock"] == [10]
    assert there["steps"] == begun["steps"] + 10
    assert there["distance"][0] < begun["distance"][0]
    place = [0.5, 0.1, float(begun["goal_position"][2])]
    put = ask(server, goal=place, follow=True)
    np.testing.assert_allclose(put["goal_position"], place, atol=1e-4)
    assert put["clock"] == [0]
    far = ask(server, goal=[9.0, 9.0, 9.0])
    low, high = arm.env.setup.task.goal_box(arm.env.setup)
    np.testing.assert_allclose(far["goal_position"], high, atol=1e-4)
    assert (np.array(far["goal_position"]) >= np.array(low) - 1e-4).all()
    again = ask(server, begin=True)
    assert (again["clock"], again["over"]) == ([0], False)


@pytest.mark.parametrize("task", ["precise", "track"])
def test_joints_are_moved_by_hand_where_the_policy_holds_the_goal(task: str) -> None:
    remote = Remote(shown(task, sim="kinematic"))
    wanted = np.add(remote.message()["q"], 0.3)
    told = [remote.play(Asked(agent="ik", command=tuple(wanted), steps=MOST_STEPS)) for _ in range(3)]
    np.testing.assert_allclose(told[-1]["q"], wanted, atol=1e-3)


def test_the_page_is_told_which_episode_it_is_though_many_steps_come_at_once(arm: Shown) -> None:
    remote = Remote(arm)
    asked = [{}, {"steps": 3}, {"begin": True, "steps": 3}, {"proceed": True}]
    told = [remote.play(Asked(agent="ik", **one)) for one in asked]
    assert [(one["begun"], one["clock"]) for one in told] == [(0, [0]), (0, [3]), (1, [3]), (2, [0])]


def test_joints_are_moved_by_hand_no_faster_than_they_are(server: PageServer, arm: Shown) -> None:
    begun = ask(server, begin=True)
    wanted = [*begun["q"]]
    wanted[0] += 0.5
    one = ask(server, agent="ik", command=wanted, steps=1)
    most = arm.env.setup.robot.speed[0] * arm.env.setup.period
    assert one["q"][0] - begun["q"][0] == pytest.approx(most, rel=1e-3)
    ask(server, agent="ik", command=wanted, steps=MOST_STEPS)
    np.testing.assert_allclose(ask(server, agent="ik", command=wanted, steps=MOST_STEPS)["q"], wanted, atol=1e-4)
    assert not ask(server)["failed"]


def test_what_is_told_is_what_the_functions_of_a_page_take() -> None:
    one = shown("clutter", robot="panda", obstacles=(1, 1))
    found = programs(one.env, _nobody(one), sampled(one.env, [(1, 0)]))
    ask_for = next(program for program in found if program.name == "ask")
    told = Remote(one).message()
    assert {output.name for output in ask_for.outputs} <= set(told)
    links = one.env.setup.robot.chain.n + 1
    assert (len(told["axes"]), len(told["positions"])) == (9 * links, 3 * links)
    np.testing.assert_allclose(told["positions"][-3:], told["tool"], atol=1e-5)


def _nobody(one: Shown) -> Any:
    """A policy as it is before training."""
    import jax

    from reachlab.learn.learner import make_initial_policy

    return make_initial_policy(one.env.config, one.env, jax.random.key(0))


def test_a_body_is_put_somewhere() -> None:
    remote = Remote(shown("clutter", robot="panda", obstacles=(1, 1)))
    told = remote.play(read_asked(b'{"body": [0, 0.55, 0.25, 0.45]}'))
    np.testing.assert_allclose(told["bodies_position"][:3], [0.55, 0.25, 0.45], atol=1e-5)
    with pytest.raises(InputError, match="body must begin with a number below"):
        remote.play(read_asked(b'{"body": [9, 0, 0, 0]}'))


def test_a_goal_is_turned() -> None:
    remote = Remote(shown("pose", robot="panda", sim="kinematic"))
    begun = remote.message()
    half = np.array(begun["goal_quaternion"]) + np.array([0.0, 0.0, 0.0, 0.3])
    asked = json.dumps({"goal": [*begun["goal_position"], *(3 * half)]}).encode()
    told = remote.play(read_asked(asked))
    assert told["reachable"]
    assert abs(np.dot(told["goal_quaternion"], half / np.linalg.norm(half))) == pytest.approx(1, abs=1e-5)


def test_the_picture_that_a_policy_observes_is_told() -> None:
    remote = Remote(shown(observation="image"))
    remote.play(read_asked(b'{"agent": "ik", "steps": 20}'))
    sent = base64.b64decode(remote.message()["picture"].partition(",")[2])
    seen = remote.player.observed_picture()
    assert seen is not None
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(sent))), seen[..., 0])


def test_a_recording_holds_whole_episodes_that_json_can_tell(arm: Shown) -> None:
    episodes = record(arm, 2)
    assert [(one[0]["clock"], one[-1]["over"]) for one in episodes] == [([0], True)] * 2
    assert episodes[0][0]["goal_position"] != episodes[1][0]["goal_position"]
    json.dumps(episodes, allow_nan=False)


# --- what anyone may send -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        (b"", "what is asked for is no JSON."),
        (b"\xff\xfe", "what is asked for is no JSON."),
        (b"[" * 30_000, "what is asked for is no JSON."),
        (b"[]", "what is asked for must be an object of settings, got list."),
        (b'{"stepz": 1}', "what is asked for holds an unknown setting 'stepz'."),
        (b'{"steps": 51}', "steps must be at least 0 and at most 50, got 51."),
        (b'{"steps": true}', "steps must be a whole number, got True."),
        (b'{"steps": 1e3}', "steps must be a whole number, got 1000.0."),
        (b'{"agent": "traind"}', "Did you mean 'trained'"),
        (
            b'{"agent": "trained", "steps": 1}',
            "agent 'trained' needs a run: name its directory, or from Python",
        ),
        (b'{"goal": [1, 2]}', "goal must have 3 or 7 numbers, got 2."),
        (b'{"goal": [NaN, 0, 0]}', "each entry of goal must be"),
        (b'{"goal": [1e999, 0, 0]}', "each entry of goal must be"),
        (b'{"goal": [0, 0, 0, 0, 0, 0, 0]}', "the goal's quaternion must not be zero."),
        (b'{"goal": "here"}', "goal must be"),
        (b'{"body": [0, 1, 2, 3]}', "body must begin with a number below 0, got 0."),
        (b'{"command": [1]}', "command must have 7 numbers, got 1."),
        (b'{"run": 1}', "run must be below 1, got 1."),
    ],
)
def test_what_a_page_would_not_send_is_refused_in_a_sentence(
    server: PageServer, body: bytes, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "SILENCE", 0.0)
    status, told = request(server, "POST", "/play", body, Content_Type="application/json")
    assert status == 400, told
    assert sentence in json.loads(told)["error"]
    assert ask(server)["status"] == 200


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("POST", "/play", {"Content_Type": "text/plain"}, 403),
        ("POST", "/play", {"Content_Type": "application/json", "Origin": "http://example.org"}, 403),
        ("POST", "/play", {"Content_Type": "application/json", "Host": "example.org"}, 403),
        ("POST", "/other", {"Content_Type": "application/json"}, 403),
        ("GET", "/etc/passwd", {}, 404),
        ("GET", "/", {"Host": "example.org"}, 404),
        ("PUT", "/play", {}, 501),
    ],
)
def test_only_the_page_itself_is_answered(
    server: PageServer, method: str, path: str, headers: dict[str, str], status: int
) -> None:
    assert request(server, method, path, b"{}", **headers)[0] == status


def test_too_much_is_not_read(server: PageServer) -> None:
    status, told = request(server, "POST", "/play", b" " * (MOST_BYTES + 1), Content_Type="application/json")
    assert (status, json.loads(told)["error"]) == (413, f"at most {MOST_BYTES} bytes are read.")


def connected(server: PageServer) -> socket.socket:
    host, port = server.url.removeprefix("http://").split(":")
    return socket.create_connection((host, int(port)), PATIENCE)


def test_those_who_are_slow_or_go_away_stop_nobody(server: PageServer) -> None:
    slow = [connected(server) for _ in range(10)]
    for number, one in enumerate(slow):
        one.sendall([b"", b"GET / HT", b"POST /play HTTP/1.1\r\nContent-Length: 9\r\n\r\n{"][number % 3])
    gone = connected(server)
    gone.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    gone.close()
    assert ask(server, agent="ik", steps=1)["status"] == 200
    assert request(server)[1] == HTML.encode()
    for one in slow:
        one.close()


def test_a_browser_that_does_not_read_the_page_is_left_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module._Handler, "timeout", 0.3)
    with serving() as server:
        server.add("x" * 50_000_000, last=True)
        with connected(server) as lazy:
            lazy.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            wait_for(lambda: server._http.free._value < MOST_CONNECTIONS)
            wait_for(lambda: server._http.free._value == MOST_CONNECTIONS)


def test_a_slow_browser_gets_all_of_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module._Handler, "timeout", 0.5)
    monkeypatch.setattr(server_module._Server, "process_request", slowly_sent)
    with serving() as server:
        server.add("x" * 1_500_000, last=True)
        with connected(server) as slow:
            slow.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
            begun, read = time.monotonic(), bytearray()
            while part := slow.recv(50_000):
                read += part
                time.sleep(0.04)
        assert time.monotonic() - begun > 2 * 0.5, "else nothing was slow"
        assert read.count(b"x") == 1_500_001  # with that of the type of content
        assert read.endswith(b"0\r\n\r\n")


def slowly_sent(self: Any, request: socket.socket, client_address: Any) -> None:
    request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 10_000)  # the kernel would take all of it at once
    self.free.acquire()
    ThreadingHTTPServer.process_request(self, request, client_address)


def wait_for(happened: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_many_connections_are_served_and_too_many_refused(arm: Shown) -> None:
    with serving(partial(Remote, arm)) as server:
        server.add(HTML, last=True)
        many = [connected(server) for _ in range(MOST_CONNECTIONS)]
        wait_for(lambda: server._http.free._value == 0)
        with pytest.raises((ConnectionError, TimeoutError)):
            request(server)
        for one in many:
            one.close()
        wait_for(lambda: server._http.free._value == MOST_CONNECTIONS)
        told: list[dict[str, Any]] = []
        threads = [threading.Thread(target=lambda: told.append(ask(server, agent="ik", steps=1))) for _ in range(32)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE)
        assert [one["status"] for one in told] == [200] * 32


def test_of_several_pages_the_first_lets_time_go_on(server: PageServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "SILENCE", 0.0)
    ask(server, "first")
    monkeypatch.setattr(server_module, "SILENCE", PATIENCE)
    first = ask(server, "first", agent="ik", begin=True, steps=3)
    other = ask(server, "other", agent="ik", steps=5)
    assert (first["clock"], other["clock"]) == ([3], [3])
    monkeypatch.setattr(server_module, "SILENCE", 0.0)
    assert ask(server, "other", agent="ik", steps=5)["clock"] == [8]


def test_a_page_that_is_opened_finds_the_first_episode_and_a_second_one_what_the_first_does(arm: Shown) -> None:
    with serving(partial(Remote, arm)) as server:
        first = ask(server)
        place = sampled(arm.env, [(arm.seed, 0)]).goal.position[0]
        np.testing.assert_allclose(first["goal_position"], place, atol=1e-5)
        ask(server, agent="ik", steps=3)
        assert ask(server, "other")["clock"] == [3]


# --- the server -----------------------------------------------------------------------------------


def test_the_page_comes_as_soon_as_its_parts_are_there() -> None:
    with serving() as server:
        server.add("begin ")
        with connected(server) as browser:
            browser.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
            came = b""
            while b"begin " not in came:
                came += browser.recv(4096)
            server.add("end", last=True)
            while part := browser.recv(4096):
                came += part
        assert b"3\r\nend\r\n0\r\n\r\n" in came


def test_a_browser_that_waits_is_let_go_when_the_server_ends() -> None:
    with serving() as server:
        server.add("begin ")
        browser = connected(server)
        browser.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
    with browser:
        while browser.recv(4096):
            pass


def test_the_next_port_is_taken_and_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with PageServer(LOCAL, 20_100) as one:
        port = int(one.url.rpartition(":")[2])
        with PageServer(LOCAL, port) as other:
            assert int(other.url.rpartition(":")[2]) > port
    assert capfd.readouterr() == ("", "")


def test_a_host_is_answered_by_its_name_in_small_letters_and_large_ones() -> None:
    with PageServer("LocalHost", 20_200) as server:
        server.add(HTML, last=True)
        port = server.url.removeprefix("http://localhost:")
        assert [request(server, Host=f"{host}:{port}")[0] for host in ("localhost", "LOCALHOST")] == [200, 200]


def test_a_host_that_is_not_this_machine_is_refused() -> None:
    with pytest.raises(InputError, match=r"host '192.0.2.1' is no address of this machine \(.+\): leave it out"):
        PageServer("192.0.2.1", 8080)


def test_no_host_and_ports_that_cannot_be_used_are_refused() -> None:
    with pytest.raises(InputError, match="host is empty: leave it out"):
        PageServer("", 8080)
    with (
        PageServer(LOCAL, 65_535),
        pytest.raises(InputError, match=r"ports 65535 to 65535 cannot be listened on \(.+ in use\): choose another"),
    ):
        PageServer(LOCAL, 65_535)


def test_what_other_machines_reach_is_known() -> None:
    assert [is_local(host) for host in ("127.0.0.1", "localhost", "0.0.0.0")] == [True, True, False]


def test_arms_of_one_name_are_drawn_as_what_they_are(tmp_path: Path) -> None:
    arms = []
    for length in (0.2, 0.3):
        file = tmp_path / str(length) / "arm.xml"
        file.parent.mkdir()
        file.write_text(ARM.format(length))
        arms.append(shown(robot=str(file)))
    assert [one.title for one in arms] == ["arm", "arm"]
    assert arms[0].scene != arms[1].scene


def test_names_are_escaped_in_the_page(arm: Shown) -> None:
    head = page_head("<script>alert(1)</script> & co", engine=False)
    assert "<title>&lt;script&gt;alert(1)&lt;/script&gt; &amp; co" in head
    assert "connect-src" not in head
    assert "connect-src 'self'" in page_head("one", engine=False, served=True)
    assert "<script>alert" not in page_body([Shown("</script><script>alert(1)", arm.env, None, "ik", why="x")])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "view needs a run directory, a policy as panda/precise, or --task with a baseline as --agent ik."),
        (
            ["a", "--out", "page.html", "--port", "9"],
            "view --out serves nothing, so --port has no effect: leave it out.",
        ),
        (["a", "--out", "none/page.html"], "there is no folder 'none'."),
        (["panda/precise", "--agent", "traind"], "Did you mean 'trained'"),
        (["a", "--port", "0"], "port must be at least 1"),
        (["a"], "run directory 'a' does not exist"),
        (["panda/precise", "--sim", "mujoko"], "Did you mean 'mujoco'"),
    ],
)
def test_wrong_words_are_refused_in_a_sentence(
    words: list[str], sentence: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["view", *words]) == cli.WRONG_INPUT
    assert sentence in capsys.readouterr().err


# --- from Python ----------------------------------------------------------------------------------


def test_a_function_of_observations_is_shown(arm: Shown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    observed: list[tuple[int, ...]] = []

    def still(observation: np.ndarray) -> np.ndarray:
        observed.append(observation.shape)
        return np.zeros((1, arm.env.action_bounds[0].size), np.float32)

    looks = itertools.count()
    asked: list[dict[str, Any]] = []

    def ended() -> bool:
        if next(looks) == 0:
            url = capsys.readouterr().out.split()[1]
            body = json.dumps({"agent": "still", "steps": 3}).encode()
            headers = {"Content-Type": "application/json"}

            def look() -> None:
                with urlopen(Request(url + "/play", body, headers), timeout=PATIENCE) as answer:
                    asked.append(json.load(answer))

            threading.Thread(target=look).start()
        return bool(asked)

    reachlab.view(arm.env, still, port=20_200, ended=ended)
    assert asked[0]["clock"] == [3]
    assert observed[0][0] == 1
    reachlab.view(arm.env, still, out=tmp_path / "still.html", episodes=1)
    assert (tmp_path / "still.html").stat().st_size > 100_000


def test_what_cannot_be_shown_is_refused(arm: Shown) -> None:
    with pytest.raises(InputError, match="agent 'trained' needs a policy"):
        reachlab.view(arm.env)
    with pytest.raises(InputError, match="Did you mean 'planner'"):
        reachlab.view(arm.env, "planer")
    with pytest.raises(InputError, match="view shows one environment, got 2: make it with num_envs=1"):
        reachlab.view(Env(arm.env.config, 2), "ik")
