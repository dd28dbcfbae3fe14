# SPDX-License-Identifier: Apache-2.0
"""The message type of transforms where its package does not exist.

PyPI has no wheel of ``tf2_msgs``. Messages pass as bytes here, so that the middleware needs the name, the hash and the
layout of the type only. They are described with structures of rosidl, whose elements exist in ``geometry_msgs``.
"""

import ctypes
from functools import cache
from importlib import import_module
from typing import Any

TRANSFORMS = "tf2_msgs/msg/TFMessage"
_HASH = bytes.fromhex("e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087")
_SERIALISATION = b"rosidl_typesupport_fastrtps_c"
_INTROSPECTION = b"rosidl_typesupport_introspection_c"
_MESSAGE_FIELD = 18

_Pointer = ctypes.c_void_p
_Find = ctypes.CFUNCTYPE(_Pointer, _Pointer, ctypes.c_char_p)
_GetHash = ctypes.CFUNCTYPE(_Pointer, _Pointer)


class _Support(ctypes.Structure):
    """``rosidl_message_type_support_t``."""

    _fields_ = (
        ("identifier", _Pointer),
        ("data", _Pointer),
        ("find", _Pointer),
        ("get_hash", _Pointer),
        ("get_description", _Pointer),
        ("get_sources", _Pointer),
    )


class _Hash(ctypes.Structure):
    """``rosidl_type_hash_t``."""

    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


class _Callbacks(ctypes.Structure):
    """``message_type_support_callbacks_t`` of Fast DDS."""

    _fields_ = (("namespace", ctypes.c_char_p), ("name", ctypes.c_char_p), ("functions", _Pointer * 5))


class _Member(ctypes.Structure):
    """``rosidl_typesupport_introspection_c__MessageMember``."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("type_id", ctypes.c_uint8),
        ("string_upper_bound", ctypes.c_size_t),
        ("members", _Pointer),
        ("is_key", ctypes.c_bool),
        ("is_array", ctypes.c_bool),
        ("array_size", ctypes.c_size_t),
        ("is_upper_bound", ctypes.c_bool),
        ("offset", ctypes.c_uint32),
        ("default", _Pointer),
        ("functions", _Pointer * 6),
    )


class _Members(ctypes.Structure):
    """``rosidl_typesupport_introspection_c__MessageMembers``."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("count", ctypes.c_uint32),
        ("size", ctypes.c_size_t),
        ("has_key", ctypes.c_bool),
        ("members", _Pointer),
        ("functions", _Pointer * 2),
    )


@cache
def transforms_class() -> Any:  # noqa: ANN401 - a class as rosidl makes them
    """Return a class that rclpy takes for `TRANSFORMS`, for messages as bytes."""
    # Another type without a bound on its size: its functions are only asked for that.
    model = import_module("std_msgs.msg").String
    element = _found(import_module("geometry_msgs.msg").TransformStamped, _INTROSPECTION)
    callbacks = _Callbacks.from_buffer_copy(_Callbacks.from_address(_found(model, _SERIALISATION).data))
    callbacks.namespace, callbacks.name = b"tf2_msgs::msg", b"TFMessage"
    member = _Member(name=b"transforms", type_id=_MESSAGE_FIELD, members=ctypes.addressof(element), is_array=True)
    members = _Members(
        namespace=b"tf2_msgs__msg", name=b"TFMessage", count=1, size=24, members=ctypes.addressof(member)
    )
    serialisation = _with_data(_found(model, _SERIALISATION), callbacks)
    introspection = _with_data(_found(model, _INTROSPECTION), members)
    supports = {
        _SERIALISATION: ctypes.addressof(serialisation),
        _INTROSPECTION: ctypes.addressof(introspection),
    }
    type_hash = _Hash(1, (ctypes.c_uint8 * 32)(*_HASH))
    find = _Find(lambda _, identifier: supports.get(identifier))
    get_hash = _GetHash(lambda _: ctypes.addressof(type_hash))
    own = _Support.from_buffer_copy(_support_of(model))
    own.data, own.find, own.get_hash = None, _address(find), _address(get_hash)
    for each in (serialisation, introspection):
        each.get_hash = own.get_hash
    new_capsule = ctypes.pythonapi.PyCapsule_New
    new_capsule.restype, new_capsule.argtypes = ctypes.py_object, [_Pointer, ctypes.c_char_p, _Pointer]
    # rclpy reads these of the class's own class.
    attributes = {
        "_TYPE_SUPPORT": new_capsule(ctypes.addressof(own), None, None),
        "_kept": (element, callbacks, member, members, serialisation, introspection, type_hash, find, get_hash, own),
        **dict.fromkeys(("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE"), False),
    }
    return type("_TransformsType", (type,), attributes)("TFMessage", (), {})


def _support_of(message: Any) -> _Support:  # noqa: ANN401 - a class made by rosidl
    kind = type(message)
    if kind._TYPE_SUPPORT is None:  # noqa: SLF001 - rclpy reads it too
        kind.__import_type_support__()
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype, get_pointer.argtypes = _Pointer, [ctypes.py_object, ctypes.c_char_p]
    return _Support.from_address(get_pointer(kind._TYPE_SUPPORT, None))  # noqa: SLF001 - as above


def _found(message: Any, identifier: bytes) -> _Support:  # noqa: ANN401 - as above
    support = _support_of(message)
    return _Support.from_address(_Find(support.find)(ctypes.addressof(support), identifier))


def _with_data(support: _Support, data: ctypes.Structure) -> _Support:
    copy = _Support.from_buffer_copy(support)
    copy.data = ctypes.addressof(data)
    return copy


def _address(function: Any) -> int | None:  # noqa: ANN401 - a function of ctypes
    return ctypes.cast(function, _Pointer).value
