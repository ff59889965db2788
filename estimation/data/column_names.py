"""Guess quantities and units from the names of columns."""

import re
import unicodedata
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from types import MappingProxyType

from palpate.estimation.data.quantity_words import CURRENT, WORDS, plain, without_accents
from palpate.estimation.data.units import BRACKETED, SI, dimension_of, normalize_unit, read_as, scaled_unit

RUN, PHASE = "run", "phase"

NO_JOINT = -1  # stands for the number of a joint that has none
Key = tuple[str, int]  # quantity, and number of the joint in the file or `NO_JOINT`
TIME, DISPLACEMENT = ("time", NO_JOINT), ("displacement", NO_JOINT)
FORCE, POSITION = ("force", NO_JOINT), ("position", NO_JOINT)

QUANTITIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "time": ("time",),
        "displacement": ("length", "strain"),
        "position": ("angle", "length"),
        "velocity": ("length_rate", "angle_rate"),
        "acceleration": ("length_rate_2", "angle_rate_2"),
        "force": ("force", "voltage", "pressure"),
        "torque": ("torque", "current"),
        "goal": ("angle",),
    }
)
"""Dimensions that each quantity may have; see `PROXIES`."""

PROXIES: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "current": ("N m", "torque constant", "0.5Nm/A"),
        "voltage": ("N", "sensor's constant", "20N/V"),
        "pressure": ("N", "area", "5e-4N/Pa"),
        "strain": ("m", "gauge length", "0.05m/strain"),
    }
)
"""Dimensions that may represent an effort or a displacement: its unit, the constant, and an example of it."""

JOINT_QUANTITIES = frozenset({"position", "velocity", "acceleration", "torque", "force", "goal"})

_SYNONYMS = {"depth": "displacement", "angle": "position"}
_NAME = re.compile(rf"({'|'.join([*QUANTITIES, *_SYNONYMS])})(?:_(\d+))?(?:_(.+))?", re.IGNORECASE)
_REPEATED = re.compile(r" \(\d+\)$")  # number of a repeated name, which a table adds
_BRACKETED = re.compile(r"\s*[\[({<]\s*(?!\d+\s*[\])}>])([^\])}>]*?)\s*[\])}>]\s*$")  # excludes indices
_BRACKETED_IN_R = re.compile(r"\.{1,2}([^.\s]+(?:\.[^.\s]+)?)\.$")  # R writes "Load (mN)" as "Load..mN."
RUN_AFTER_UNIT = re.compile(  # as in "Force (N) Run #1"
    r"(?<=[])}]) (?:run|test|trial|specimen) ?#? ?\d+$", re.IGNORECASE
)
SENSITIVITY = re.compile(r"\s*[\[({]\s*([\d.][^\])}]*/[^\])}]*)[\])}]")  # as in "Load [V] (5 N/V)"
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_BRACKETED_IN_FRONT = re.compile(r"^\s*[\[({<]\s*([^\])}>]+?)\s*[\])}>]\s*(?=\S)")  # "[mm] Travel"
_UNIT_AFTER_SIGN = re.compile(r"\s*(?:/|,|:|\||\bin\b)\s*([^\s/,:|]+)\s*$")


OWN_NAME, _BY_NAME, _BY_WORD, _BY_UNIT, _BY_PAIR = 4, 3, 2, 1, 0


@dataclass(frozen=True)
class Role:
    """Quantity, joint and unit of a column, stated in its name or guessed from it."""

    column: str  # name of the column in the file
    quantity: str  # key of `QUANTITIES`, or "run"; empty for none
    joint: int = NO_JOINT  # number of the joint in the file, or `NO_JOINT`
    unit: str = ""  # normalized unit; empty if the name has none
    rank: int = _BY_NAME  # how well the name fits; palpate's own names rank highest
    why: str = ""  # reason in words
    joint_name: tuple[str, ...] = ()  # further words in the name, such as the joint whose position it is

    @property
    def key(self) -> Key:
        """Quantity and joint, unique among the columns in use."""
        return self.quantity, self.joint

    @property
    def numbered(self) -> str:
        """Quantity with the joint's number, see `numbered`."""
        return numbered(self.key)

    @property
    def fit(self) -> tuple[bool, int, bool]:
        """Sort key for columns of one quantity: those that represent an effort come last."""
        is_current = not self.unit and not CURRENT.isdisjoint(words_of(self.column))
        return dimension_of(self.unit) not in PROXIES and not is_current, self.rank, bool(self.unit)


def numbered(key: Key) -> str:
    """Return a quantity with the joint's number, as in options: "position_2" or "force".

    Args:
        key: quantity, and number of the joint in the file or `NO_JOINT`.
    """
    quantity, joint = key
    return quantity if joint == NO_JOINT else f"{quantity}_{joint}"


def parse_role(name: str) -> Role | None:
    """Parse a name such as `position_2_rad`, `force_N` or `time`; None for other names.

    Args:
        name: name of a column, or value of an option.
    """
    match = _NAME.fullmatch(name.strip())
    if not match:
        return None
    named, number, ending = match.group(1).lower(), match.group(2), match.group(3) or ""
    quantity = _SYNONYMS.get(named, named)
    has_joint = number and (int(number) > 0 or quantity in JOINT_QUANTITIES)
    unit = read_as(normalize_unit(ending), QUANTITIES[quantity])
    if unit and dimension_of(unit) not in QUANTITIES[quantity]:
        return None
    if named == "angle" and dimension_of(unit) != "angle":  # without a unit it may be any angle
        return None
    rank = OWN_NAME if unit else _BY_NAME
    return Role(name, quantity, int(number) if has_joint else NO_JOINT, unit, rank, "by its name")


def role_of_option(name: str) -> Role | None:
    """Return the role named in an option, possibly by a word such as `extension`; None for other names.

    Args:
        name: name as the user wrote it.
    """
    if role := parse_role(name):
        return role
    guess = guess_column(name)
    dimensions = {None, *QUANTITIES.get(guess.quantity, ())}
    if guess.rank <= _BY_UNIT or len(dimensions) == 1 or dimension_of(guess.unit) not in dimensions:
        return None
    return guess


def split_unit(name: str) -> tuple[str, str]:
    """Split a column's name into the part before its unit and the normalized unit; empty if unknown.

    Units are in brackets, after a slash, a comma or "in", or at the end: "Weg / mm", "load_mN", "Load N".
    The number of a run may follow the brackets. Brackets with a unit may also be in front: "[mm] Weg".

    Args:
        name: name of a column.
    """
    name = unicodedata.normalize("NFKC", name)  # converts full-width characters
    name = _unit_behind(RUN_AFTER_UNIT.sub("", name))
    if stated := SENSITIVITY.search(name):
        stem, own = split_unit(SENSITIVITY.sub("", name))
        if dimension_of(own) in PROXIES:  # such as "×5.0N" for "5N_V" or "0.2V_N"
            scale, unit = scaled_unit(normalize_unit(stated[1]), own)
            if "_" in unit:  # volts per newton
                above, _, unit = unit.partition("_")
                below, scale = f"1{unit}_{above}", 1.0 / scale if scale else 0.0
                ratio, unit = scaled_unit(normalize_unit(below), own)
                scale *= ratio
            if scale and dimension_of(unit) in {"force", "torque", "length"}:
                return stem, f"×{scale:.12g}{unit}"
    match = _BRACKETED.search(name)
    stem, _, last = name.strip().rpartition(" ")
    if not match and stem and "/" in last and dimension_of(unit := normalize_unit(last)):
        return stem.removesuffix(" in"), unit
    match = match or _UNIT_AFTER_SIGN.search(name)
    if match and dimension_of(unit := normalize_unit(match[1])):
        return name[: match.start()], unit
    if match and match.re is _BRACKETED:
        return name[: match.start()], ""
    parts = re.split(r"[_ ]", name.strip())
    for count in (2, 1):
        if len(parts) <= count:
            continue
        stem = "_".join(parts[:-count])
        for mark in ("_", ""):  # "mm s" may be mm/s, "kgf cm" is a product
            ending = normalize_unit(mark.join(parts[-count:]))
            if dimension_of(ending) and ending not in BRACKETED and "×" not in ending:
                return (name, "") if _is_index(parts[-1], stem, ending) else (stem, ending)
    return name, ""


def _is_index(letters: str, stem: str, unit: str) -> bool:
    """Return whether the last letters of a name are an index, as in "tau_m" of a motor, and not a unit.

    Such letters are a unit only if a quantity that the rest of the name means is measured in it. Grams and
    amperes are no units behind a mere symbol, such as "P_g", the gauge pressure, and an A may label a thing.
    """
    if letters.lower() not in _INDICES or letters == "N":
        return False
    last = words_of(stem)[-1:]
    quantity = _quantity_of(last) if CURRENT.isdisjoint(last) else "torque"
    if not quantity:
        is_symbol = len(stem) < _SHORTEST_WORD
        is_label = not _LABELED.isdisjoint(last) or (is_symbol and stem.isalpha())
        return letters == "a" or (letters == "A" and is_label) or (letters.lower() == "g" and is_symbol)
    return not _fits(quantity, unit) or (dimension_of(unit) == "length" and not _ANGLES.isdisjoint(last))


def _unit_behind(name: str) -> str:
    """Move a unit in brackets, if it is the only one, from the front of a name to its end: "Weg [mm]"."""
    if (dotted := _BRACKETED_IN_R.search(name)) and dimension_of(normalize_unit(dotted[1])):
        return f"{name[: dotted.start()]} [{dotted[1]}]"
    front, end = _BRACKETED_IN_FRONT.match(name), _BRACKETED.search(name)
    if not front or not dimension_of(normalize_unit(front[1])):
        return name
    if end and dimension_of(normalize_unit(end[1])):
        return name
    return f"{name[front.end() :].rstrip()} [{front[1]}]"


def unknown_unit(name: str) -> str:
    """Return the text in brackets at the end of a name, or a word such as "counts", if it is an unknown unit.

    Args:
        name: name of a column.
    """
    match = _BRACKETED.search(_unit_behind(_REPEATED.sub("", unicodedata.normalize("NFKC", name))))
    if match and not dimension_of(normalize_unit(match[1])):
        return match[1]
    return next((word for word in re.findall(r"[a-z]+", name.lower()) if word in _COUNTS), "")


def holds_counts(name: str) -> bool:
    """Return whether a column without a unit contains counts of an encoder or converter.

    Args:
        name: name of a column.
    """
    return not (_COUNTS | _ENCODER).isdisjoint(re.findall(r"[a-z]+", name.lower()))


def unit_in_name(name: str) -> str:
    """Return the normalized unit in a column's name; empty without a known unit."""
    return split_unit(_REPEATED.sub("", name))[1]


def is_angle(name: str) -> bool:
    """Return whether a column holds an angle, by the unit in its name or else by a word.

    Args:
        name: name of a column.
    """
    unit = unit_in_name(name)
    return dimension_of(unit) == "angle" or (not unit and not _ANGLES.isdisjoint(words_of(name)))


def si_unit(dimension: str) -> str:
    """Return the SI unit of a dimension, as it is spelled in column names.

    Args:
        dimension: dimension, such as "force".
    """
    return next(unit for unit, factor in SI[dimension].items() if factor == 1.0)


COUNTERS = frozenset(  # in the names of columns that count time in an unknown unit
    "tick ticks stamp counter count counts cnt index idx sample samples frame frames seq".split()  # noqa: SIM905
)
_COUNTS = frozenset(["counts", "count", "ticks", "raw", "adc", "lsb"])  # numbers without a known unit
_ANGLES = frozenset("angle angles theta winkel angulo angolo encoder encoders enc".split())  # noqa: SIM905
# Durations that have a unit of time but are no clock.
_NO_CLOCK = frozenset(["pwm", "pulse", "esc", "delay", "latency", "lag"])
# Accelerations in g, which are no forces in grams.
_NO_FORCE = frozenset(
    "acc accel acceleration accelerometer beschleunigung aceleracion accelerazione ax ay az".split()  # noqa: SIM905
)
_TEMPERATURES = frozenset(["C", "°C", "K", "F", "°F"])
_INDICES = frozenset(["m", "s", "g", "h", "n", "a", "in", "min"])  # units that may be indices, as in "tau_m"
_LABELED = frozenset(  # things that may be labeled A and B
    "pressure druck presion pression pressione chamber sensor channel cell port side specimen".split()  # noqa: SIM905
)
_SHORTEST_WORD = 3  # letters; shorter names are symbols
_ENCODER = frozenset(["encoder", "encoders", "enc"])
GEAR_SIDES = frozenset(["motor", "rotor", "output", "link"])  # between which a gear may be
_UNINFORMATIVE = frozenset(
    "actual act measured meas feedback fb present ist joint joints state states j value values".split()  # noqa: SIM905
)
_NOT_MEASURED = frozenset(
    [
        *("set", "setpoint", "target", "cmd", "command", "commanded", "goal", "desired", "des", "reference"),
        *("ref", "soll", "error", "err", "max", "min", "peak", "rate", "limit", "std", "mean", "stress"),
        *("strain", "offset", "temperature", "temp", "maximum", "minimum", "maximal", "maximale", "maximo"),
        *("sollwert", "sollweg", "sollkraft", "consigne", "cible", "objetivo", "zadana", "zadane"),
    ]
)
# Columns of a tension test, which are used only if there is no displacement and no force.
_TENSION_TEST = {"strain": ("displacement", "strain"), "stress": ("force", "")}  # quantity and default unit
# Words for the goal of a position servo, which is used only if there is no effort.
_GOAL = frozenset(
    "goal target desired des cmd command commanded set setpoint soll reference ref action".split()  # noqa: SIM905
)
_KNOWN = tuple((quantity, known) for quantity, known in WORDS.items() if quantity != RUN)
_BY_DIMENSION = {"length": "displacement", "angle": "position"} | {n: n for n in ("time", "force", "torque")}
# "Position des Kolbens" is the position of the piston, "Allongement des mors" the extension of the jaws, but
# "Position des" is a desired position.
_ARTICLE = re.compile(
    rf"(?i:\b({'|'.join(word for words in WORDS.values() for word in sorted(words) if len(word) > 2)})) des "
    r"(?=[A-Z][a-z]{3}|(?!joint|axis|pos|vel|angle|torque|force)[a-z]{3})"
)
_REPEATED_NAME = re.compile(r"(.+) \((\d+)\)")  # a repeated name
_UNNAMED = re.compile(r"column \d+")
_MOTION_OR_TORQUE = ("position", "velocity", "torque")  # quantities that a file may have for each joint
_RADIANS = {"position": "rad", "velocity": "rad_s"}
_INTERFACES = (  # names whose units are specified: ROS (REP 103), RTDE, libfranka, Arduino, rpm
    (re.compile(r"joint_states\W"), _RADIANS | {"torque": "Nm"}),
    (re.compile(r"^actual_(q|qd|current)_\d$"), _RADIANS | {"torque": "A"}),
    (re.compile(r"^(q|dq|tau_J)\[\d\]$"), _RADIANS | {"torque": "Nm"}),
    (re.compile(r"^(.*[_ .])?rpm([_ .]?\d)?$", re.IGNORECASE), {"velocity": "rpm"}),
    (re.compile(r"^millis(\(\))?$"), {"time": "ms"}),
    (re.compile(r"^micros(\(\))?$"), {"time": "us"}),
)


def guess_columns(names: Sequence[str], clocks: Collection[str] = ()) -> list[Role]:
    """Guess the quantity of each column, with the joint's number as in the file.

    Args:
        names: names of the columns.
        clocks: columns with clock times in seconds; units in their names are ignored.
    """
    # If the header contains only units ("mm", "kN", "s"), they determine the quantities.
    units = {name: normalize_unit(name.strip("[]() ")) for name in names if not is_unnamed(name)}
    units_only = sum(map(bool, map(dimension_of, units.values()))) >= max(2.0, 0.6 * len(units))

    def is_repeated(name: str) -> bool:
        repeated = _REPEATED_NAME.fullmatch(name)
        return repeated is not None and repeated[1] in names

    def guess_alone(name: str) -> Role:
        if is_repeated(name):
            return Role(name, "")
        if name in clocks:
            return replace(guess_column(f"{split_unit(name)[0]} [s]"), column=name)
        quantity = _BY_DIMENSION.get(dimension_of(units.get(name, "")) or "", "") if units_only else ""
        if quantity:
            return Role(name, quantity, NO_JOINT, units[name], _BY_UNIT, "by its unit")
        return guess_column(name)

    guesses = with_whole_joint_names(list(map(guess_alone, names)))
    # Named joints, such as "/elbow/position", get numbers if they have a position and a torque, or a velocity
    # if the file has no position. A word without a unit determines a quantity only in such a pair.
    named = [
        guess
        for guess in guesses
        if guess.quantity in _MOTION_OR_TORQUE and guess.joint == NO_JOINT and guess.rank < OWN_NAME
    ]
    quantities_by_name = {(guess.joint_name, guess.quantity) for guess in named}
    motion = "position" if any(guess.quantity == "position" for guess in guesses) else "velocity"
    joints = [
        name
        for name in dict.fromkeys(guess.joint_name for guess in named)
        if {(name, motion), (name, "torque")} <= quantities_by_name
    ]
    number = {name: n if len(joints) > 1 else NO_JOINT for n, name in enumerate(joints, 1)}
    # A torque without a joint name may belong to any position.
    shared = len(joints) < 2 and any(
        guess.quantity == "torque" and guess.joint == NO_JOINT and guess.rank > _BY_PAIR for guess in guesses
    )
    # If the names form no channel, the last word of a name without a unit is used too: "Standard force".
    missing = {"time"} - {guess.quantity for guess in guesses}
    if not channel_pairs({guess.key for guess in guesses if guess.quantity}):
        missing |= {"displacement", "force"} - {guess.quantity for guess in guesses}
        guesses = [_guess_tension_test(guess) if guess.quantity == "" else guess for guess in guesses]
    paired = []
    for guess in guesses:
        if guess in named and guess.joint_name in number:
            paired.append(replace(guess, joint=number[guess.joint_name]))
        elif (guess.rank, guess.joint) == (_BY_PAIR, NO_JOINT) and not (
            shared and guess.quantity == "position"
        ):
            paired.append(Role(guess.column, ""))
        elif not guess.quantity and (quantity := quantity_in(guess.column, last=True)) in missing:
            paired.append(Role(guess.column, quantity, rank=_BY_PAIR, why="by the last word of its name"))
        else:
            paired.append(guess)
    if channel_pairs({guess.key for guess in paired if guess.quantity}):
        return paired
    # Otherwise any word of a name is used, such as "Pos" in "motorPosRaw" and "force" in "ForceArray b",
    # unless the names belong to different joints.
    known = {guess.quantity for guess in paired}
    by_word = [guess_column(name, anywhere=True) for name in names]
    joint_words = [
        words
        for guess in by_word
        if guess.quantity in _MOTION_OR_TORQUE
        and (words := {word for word in guess.joint_name if not word.isdecimal()})
    ]
    if joint_words and not set.intersection(*joint_words):
        return paired
    return [
        guess if guess.quantity or other.quantity in known or is_repeated(guess.column) else other
        for guess, other in zip(paired, by_word, strict=True)
    ]


def with_whole_joint_names(guesses: Sequence[Role]) -> list[Role]:
    """Make numbers a part of the joints' names where several joints share a number: "FL0_pos", "FR0_pos".

    At least two of these joints must have both a motion and a torque. The sides of a gear, such as motor and
    link, are no joints.

    Args:
        guesses: guesses of single columns.
    """
    numbered = [
        g for g in guesses if g.quantity in _MOTION_OR_TORQUE and g.joint != NO_JOINT and g.joint_name
    ]
    names_by_key: dict[Key, set[tuple[str, ...]]] = {}
    for guess in numbered:
        names_by_key.setdefault(guess.key, set()).add(guess.joint_name)
    are_several = any(
        len(names & names_by_key.get(("torque", joint), set())) > 1
        and GEAR_SIDES.isdisjoint(chain.from_iterable(names))
        for (quantity, joint), names in names_by_key.items()
        if quantity != "torque"
    )
    return [replace(g, joint=NO_JOINT) if are_several and g in numbered else g for g in guesses]


def _guess_tension_test(guess: Role) -> Role:
    """Read a strain as a displacement and a stress as a force; the guess is unchanged for other columns."""
    unit = split_unit(guess.column)[1]
    measured = _NOT_MEASURED.intersection(words_of(guess.column))  # with the unit: "True strain" ends in one
    word = next((word for word in _TENSION_TEST if {word} == measured), None)
    if word is None:
        return guess
    quantity, usual_unit = _TENSION_TEST[word]
    return Role(guess.column, quantity, NO_JOINT, unit or usual_unit, _BY_WORD, "by its name")


def is_unnamed(name: str) -> bool:
    """Return whether a column is named only by its position, such as "column 2"."""
    return _UNNAMED.fullmatch(name) is not None


def channel_pairs(
    available: Collection[Key], fits: Callable[[Key, Key], bool] = lambda motion, effort: True
) -> list[tuple[Key, Key]]:
    """Return motion and effort of each channel that the quantities allow, as keys.

    The velocity of a joint without a position is its motion, since the integral is a position. If there is no
    other channel, the goals of servos replace the efforts, which were not measured.

    Args:
        available: quantities, each with the number of its joint.
        fits: whether the motion and the effort of a joint belong together.
    """
    contact = [(DISPLACEMENT, FORCE)] if {DISPLACEMENT, FORCE} <= {*available} else []
    joints = sorted({joint for quantity, joint in available if quantity in {"position", "velocity"}})
    free = {*available} - {effort for _, effort in contact}
    pairs = [*contact]
    for joint in joints:
        motion = ("position" if ("position", joint) in available else "velocity", joint)
        efforts = (("torque", joint), ("force", joint))
        pairs += [(motion, effort) for effort in efforts if effort in free and fits(motion, effort)][:1]
    servos = [(("position", joint), ("goal", joint)) for joint in joints]
    return pairs or [pair for pair in servos if {*pair} <= {*available} and fits(*pair)]


def words_of(name: str) -> list[str]:
    """Return the words of a name in the spelling of `WORDS`: "Motor_torque 2" and "motorTorque" have two.

    Args:
        name: name of a column.
    """
    return re.findall(r"[^\W\d_]+", plain(_CAMEL.sub(" ", without_accents(name))))


def quantity_in(name: str, *, last: bool = False) -> str:
    """Return the quantity that a word in a name means, regardless of the unit; "none" for unmeasured signals.

    Args:
        name: name of a column.
        last: consider only the last word, which must have at least three letters, as in "log:timestamp".
    """
    words = words_of(name)
    if _NOT_MEASURED & set(words):
        return "none"
    words = words[-1:] if last else words
    return _quantity_of({word for word in words if len(word) > 2 or not (last or word.isascii())})


def _quantity_of(words: Collection[str]) -> str:
    """Return the quantity that one of the words means; beside another word, "current" may mean "present"."""
    word_sets = (set(words) - CURRENT, set(words))
    return next((quantity for chosen in word_sets for quantity, known in _KNOWN if known & chosen), "")


@lru_cache(maxsize=4096)  # a name is examined in several steps
def guess_column(name: str, *, anywhere: bool = False) -> Role:
    """Guess the quantity of a column from its name alone.

    Args:
        name: name of the column.
        anywhere: without a unit, use a word anywhere in the name, not only the last one.
    """
    if role := parse_role(name):
        return role
    if plain(name.strip()) in WORDS[RUN]:
        return Role(name, RUN, why="by its name")
    stem, unit = split_unit(name)
    stem = _ARTICLE.sub(r"\1 ", _CAMEL.sub(" ", without_accents(stem)))
    words = re.findall(r"[^\W\d_]+|\d+", stem)
    numbers = [int(word) for word in words if word.isdecimal() and len(word) < 4]
    letters = [plain(word) for word in words if not word.isdecimal()]
    joint = numbers[0] if len(numbers) == 1 else NO_JOINT
    is_goal = _GOAL & set(letters) and not {*letters} - _GOAL - _UNINFORMATIVE - WORDS["position"]
    if is_goal and dimension_of(unit) in {None, "angle"}:
        return Role(name, "goal", joint, unit, _BY_WORD, "by a word in its name")
    if _NOT_MEASURED & set(letters):
        return Role(name, "")
    is_count = not _COUNTS.isdisjoint(letters)
    letters = [word for word in letters if word not in _UNINFORMATIVE | _COUNTS]
    if not WORDS["torque"].isdisjoint(letters):
        unit = read_as(unit, QUANTITIES["torque"])
    quantity, rank = _match_words("".join(letters), letters, unit, anywhere=anywhere) if letters else ("", 0)
    rank = min(rank, _BY_WORD) if is_count else rank
    is_temperature = quantity == "time" and unknown_unit(name) in _TEMPERATURES
    is_reactive_power = quantity == "position" and "power" in letters  # q
    if not quantity or is_temperature or is_reactive_power:
        return Role(name, "")
    if quantity not in _MOTION_OR_TORQUE:
        joint = NO_JOINT
    # `WORDS` has none for acceleration.
    uninformative = WORDS.get(quantity, frozenset()) | _UNINFORMATIVE | _COUNTS
    uninformative |= CURRENT if quantity == "torque" else frozenset()
    joint_name = tuple(word.lower() for word in words if plain(word) not in uninformative)
    why = ("by this and other names", "by its unit", "by a word in its name", "by its name")[rank]
    specified = next((units.get(quantity, "") for pattern, units in _INTERFACES if pattern.search(name)), "")
    return Role(name, quantity, joint, unit or specified, rank, why, joint_name)


def _match_words(whole: str, words: Sequence[str], unit: str, *, anywhere: bool) -> tuple[str, int]:
    """Return quantity and rank: by the whole name, by a word with a matching unit, or by the unit."""
    dimension = dimension_of(unit)
    long = [word for word in words if len(word) > 2]
    for quantity, known in _KNOWN:
        named = whole in known or (quantity == "torque" and dimension == "current" and whole in CURRENT)
        if named and (dimension is None or _fits(quantity, unit)):
            return quantity, _BY_NAME
    for quantity, known in _KNOWN:
        if _fits(quantity, unit) and not known.isdisjoint(long):
            return quantity, _BY_WORD
    is_specific = dimension not in {"voltage", "pressure", "strain"}  # these may belong to any quantity
    is_specific &= dimension != "time" or _NO_CLOCK.isdisjoint(words)
    is_specific &= dimension != "force" or _NO_FORCE.isdisjoint(words)
    by_unit = next((quantity for quantity in QUANTITIES if is_specific and _fits(quantity, unit)), "")
    by_pair = next((quantity for quantity in _MOTION_OR_TORQUE if words[-1] in WORDS[quantity]), "")
    by_pair = by_pair or "torque" * (words[-1] in CURRENT)
    if anywhere and not by_pair and dimension is None:
        by_pair = _quantity_of(long)
    return (by_unit, _BY_UNIT) if by_unit else (by_pair, _BY_PAIR)


def _fits(quantity: str, unit: str) -> bool:
    return dimension_of(unit) in QUANTITIES[quantity]
