"""Messages of a page to NiceGUI over socket.io: which of them a page can have sent."""

import json
from typing import Any

# Engine.IO: the connection ends, answer to a ping
PLAIN = ("1", "3")
CONNECT, DISCONNECT, EVENT = "40", "41", "42"
LONGEST_NUMBER = 9  # digits of a message's own number
LEVELS = ("debug", "info", "warning", "error")


def is_sound(message: Any) -> bool:
    """Return whether a message has the form that a page gives it.

    NiceGUI and socket.io raise errors for any other one.

    Args:
        message: The message's text; a page sends no bytes.
    """
    if not isinstance(message, str):
        return False
    if message in PLAIN or message == DISCONNECT:
        return True
    kind, rest = message[:2], message[2:]
    if kind == CONNECT:
        return not rest or isinstance(_parse(rest), dict)
    if kind != EVENT:
        return False
    text = rest.lstrip("0123456789")
    if len(rest) - len(text) > LONGEST_NUMBER:
        return False
    found = _parse(text)
    if not (isinstance(found, list) and len(found) == 2 and isinstance(found[1], dict)):
        return False
    name, content = found
    check = _CHECKS.get(name) if isinstance(name, str) else None
    return check is not None and isinstance(content.get("client_id"), str) and check(content)


def _parse(text):
    """Return the value of a JSON text, or None."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):  # RecursionError: lists in lists
        return None


def _is_handshake(content):
    number = content.get("next_message_id")
    is_number = (
        number is None or _is_whole(number) or (isinstance(number, str) and number.isdigit())
    )
    texts = all(isinstance(content.get(name), str) for name in ("tab_id", "document_id"))
    return texts and is_number and isinstance(content.get("old_tab_id"), str | None)


def _is_event(content):
    arguments = content.get("args", [])
    return (
        _is_whole(content.get("id"))
        and isinstance(content.get("listener_id"), str)
        and isinstance(arguments, list)
        and all(one is None or _is_json(one) for one in arguments)
    )


def _is_json(text):
    if not isinstance(text, str):
        return False
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _is_answer(content):
    return isinstance(content.get("request_id"), str)


def _is_acknowledgement(content):
    return _is_whole(content.get("next_message_id"))


def _is_log(content):
    return content.get("level") in LEVELS and isinstance(content.get("message"), str)


def _is_whole(value):
    return type(value) is int and abs(value) < 2**53


_CHECKS = {
    "handshake": _is_handshake,
    "event": _is_event,
    "javascript_response": _is_answer,
    "ack": _is_acknowledgement,
    "log": _is_log,
}
