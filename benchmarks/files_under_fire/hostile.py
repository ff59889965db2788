"""Texts that mean no good, or nothing."""

_BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
TEXTS = (
    "",
    " ",
    "\x1b[2J[/red]",
    "null",
    "[]",
    "3",
    "a: b: c",
    "{",
    "!!python/object/apply:os.system ['touch /tmp/owned']",
    "&a [*a]",
    _BOMB,
    "[" * 20_000,
    "{a: " * 5_000,
    "k: 1\nk: 2\n",
    "\ufeffname: x",
    "name: \u202eabc\u0000",
    "name: " + "x" * 2_000_000,
    "1e999",
    "\t- a",
    "<<: *x",
    '{"0": 5, "x": []}',
    "? [a, b]\n: c\n",
)

_ROBOT = '<robot name="r">{}</robot>'
_LINK = (
    '<link name="{}"><inertial><mass value="{}"/>'
    '<inertia ixx="{}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
)
_JOINT = (
    '<joint name="{0}" type="{3}"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
)


def _chain(count: int, mass: str = "1", inertia: str = "1", kind: str = "revolute") -> str:
    links = "".join(_LINK.format(f"l{n}", mass, inertia) for n in range(count + 1))
    joints = "".join(_JOINT.format(f"j{n}", f"l{n}", f"l{n + 1}", kind) for n in range(count))
    return _ROBOT.format(links + joints)


_CYCLE = _ROBOT.format(
    "".join(_LINK.format(name, 1, 1) for name in "ab")
    + _JOINT.format("j", "a", "b", "revolute")
    + _JOINT.format("k", "b", "a", "revolute")
)
_MESH = '<link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link>'
URDFS = (
    *TEXTS,
    "<robot",
    "<robot/>",
    '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>',
    '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>',
    _CYCLE,
    _chain(3000),
    _chain(3),
    _chain(3, mass="nan"),
    _chain(3, mass="-1"),
    _chain(3, mass="1e999"),
    _chain(3, inertia="1,5"),
    _chain(3, inertia="-1"),
    _chain(3, inertia="inf"),
    _chain(2, mass="0"),
    _chain(1),
    _chain(3, kind="prismatic"),
    _chain(3, kind="floating"),
    _chain(3, kind="\x1b[2J"),
    _ROBOT.format(_MESH.format("file:///etc/passwd")),
    _ROBOT.format(_MESH.format("/dev/zero")),
    _ROBOT.format(_MESH.format("http://127.0.0.1:9/x.stl")),
    _ROBOT.format("<link name='a'/>" * 2),
    _ROBOT.format("<a>" * 5000 + "</a>" * 5000),
)
