"""Sharing of memory and semaphores with Vulkan and CUDA, where the driver imports them (`cl_khr_external_memory`,
`cl_khr_external_semaphore`).

pyopencl's wheels are built without these calls, so they go through ctypes to the OpenCL loader that pyopencl uses.
"""

from __future__ import annotations

import ctypes as ct
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError, Unique
from gffe_cl.engine.core.validation import require_choice, require_kind, require_list, require_whole, shown
from gffe_cl.engine.opencl.device import Device, adopted_events

_MEMORY, _SEMAPHORE = "cl_khr_external_memory", "cl_khr_external_semaphore"
_IMPORTED_TYPES = 0x204F  # CL_DEVICE_EXTERNAL_MEMORY_IMPORT_HANDLE_TYPES_KHR
_IMPORTED_SEMAPHORES = 0x204D  # CL_DEVICE_SEMAPHORE_IMPORT_HANDLE_TYPES_KHR
_SEMAPHORE_TYPE, _BINARY = 0x203D, 1
_SEMAPHORE_TYPES = {"opaque_fd": 0x2055, "opaque_win32": 0x2056, "opaque_win32_kmt": 0x2057}
_HANDLE_TYPES = {"opaque_fd": 0x2060, "opaque_win32": 0x2061, "opaque_win32_kmt": 0x2062, "dma_buf": 0x2067}
_MOST_HANDLE = 2**63 - 1
_P, _INT, _UINT, _SIZE = ct.c_void_p, ct.c_int32, ct.c_uint32, ct.c_size_t


@dataclass(frozen=True)
class SharingSupport:
    """Sharing with other APIs that a device's driver supports.

    Attributes
    ----------
    memory : tuple of str
        Memory of other APIs (`MemorySharing`), by the types of handles that can be imported: "opaque_fd", "dma_buf"
        (Linux), "opaque_win32", "opaque_win32_kmt" (Windows); empty: none.
    semaphores : tuple of str
        Semaphores of Vulkan (`MemorySharing.semaphore`), likewise: "opaque_fd", "opaque_win32", "opaque_win32_kmt".
    """

    memory: tuple[str, ...]
    semaphores: tuple[str, ...] = ()


def sharing_support(device: Device) -> SharingSupport:
    """Return the sharing with other APIs that the driver of `device` reports. Raises GffeError if it is no Device."""
    own = require_kind(device, Device, "sharing_support: device", "an open Device").cl_device
    extensions = _extensions(own)

    def imported(extension: str, question: int, names: dict[str, int]) -> tuple[str, ...]:
        if extension not in extensions:
            return ()
        ask = _function(own.platform, "clGetDeviceInfo", _INT, _P, _UINT, _SIZE, _P, _P)
        nbytes, types = _SIZE(), (_UINT * 16)()
        error = ask(own.int_ptr, question, ct.sizeof(types), types, ct.byref(nbytes))
        found = () if error else types[: nbytes.value // ct.sizeof(_UINT)]
        return tuple(name for name, number in names.items() if number in found)

    memory = imported(_MEMORY, _IMPORTED_TYPES, _HANDLE_TYPES)
    return SharingSupport(memory, imported(_SEMAPHORE, _IMPORTED_SEMAPHORES, _SEMAPHORE_TYPES))


class MemorySharing(Unique):
    """Sharing of memory of Vulkan or CUDA, which OpenCL uses in place. `buffer` imports it. Buffers are acquired before
    OpenCL uses them, and released before the other API does. With semaphores (`semaphore`, `wait`, `signal`) no host
    waits between the APIs.

    Parameters
    ----------
    device : Device
        A device on the same GPU as the other API's.

    Raises
    ------
    GffeError
        Where the driver does not support the import of memory.
    """

    def __init__(self, device: Device):
        support = sharing_support(device)
        self.device, self.types, self.semaphore_types = device, support.memory, support.semaphores
        if not self.types:
            name = device.info.name
            raise GffeError(f"{name}: the driver does not offer external memory ({_MEMORY}, see sharing_support)")

    def buffer(self, kind: str, handle: int, nbytes: int) -> cl.Buffer:
        """Return memory that another API exported, from its first byte on, as a device buffer of `nbytes`.

        `kind` is a type of handle that `SharingSupport.memory` lists, `handle` a file descriptor or a Windows handle. A
        file descriptor belongs to the driver afterwards: do not close it. Raises GffeError for other values, and where
        the driver refuses it.
        """
        number = _HANDLE_TYPES[require_choice(kind, self.types, "MemorySharing: kind")]
        given = require_whole(handle, "MemorySharing: handle", 0, _MOST_HANDLE)
        size = require_whole(nbytes, "MemorySharing: nbytes", 1, _MOST_HANDLE)
        properties, error = (ct.c_uint64 * 3)(number, given, 0), _INT()
        platform, name = self.device.cl_device.platform, "clCreateBufferWithProperties"
        create = _function(platform, name, _P, _P, _P, ct.c_uint64, _SIZE, _P, _P)
        flags = int(cl.mem_flags.READ_WRITE)
        made = create(self.device.context.int_ptr, properties, flags, size, None, ct.byref(error))
        _require_success(name, error.value)
        buffer: Any = cl.Buffer.from_int_ptr(made, retain=False)
        return buffer

    def acquire(self, buffers: Iterable[cl.Buffer], wait_for: Iterable[cl.Event | int] = ()) -> cl.Event:
        """Enqueue taking `buffers` over from the other API, on the device's queue, once `wait_for` is complete, and
        return the event of that. The other API must be done with them. Raises GffeError for other values, and where the
        driver fails."""
        return self._move("clEnqueueAcquireExternalMemObjectsKHR", buffers, wait_for)

    def release(self, buffers: Iterable[cl.Buffer], wait_for: Iterable[cl.Event | int] = ()) -> cl.Event:
        """Enqueue giving `buffers` back to the other API, on the device's queue, once `wait_for` is complete, and
        return the event of that. The other API may use them when the event is complete. Raises GffeError for other
        values, and where the driver fails."""
        return self._move("clEnqueueReleaseExternalMemObjectsKHR", buffers, wait_for)

    def semaphore(self, kind: str, handle: int) -> SharedSemaphore:
        """Return a binary semaphore that Vulkan exported, for `wait` and `signal`.

        `kind` is a type of handle that `SharingSupport.semaphores` lists, `handle` a file descriptor, which belongs to
        the driver afterwards, or a Windows handle. Raises GffeError for other values, and where the driver refuses it
        or offers no semaphores.
        """
        if not self.semaphore_types:
            raise GffeError(f"{self.device.info.name}: the driver does not offer semaphores ({_SEMAPHORE})")
        number = _SEMAPHORE_TYPES[require_choice(kind, self.semaphore_types, "MemorySharing: kind")]
        given = require_whole(handle, "MemorySharing: handle", 0, _MOST_HANDLE)
        properties, error = (ct.c_uint64 * 5)(_SEMAPHORE_TYPE, _BINARY, number, given, 0), _INT()
        platform, name = self.device.cl_device.platform, "clCreateSemaphoreWithPropertiesKHR"
        made = _function(platform, name, _P, _P, _P, _P)(self.device.context.int_ptr, properties, ct.byref(error))
        _require_success(name, error.value)
        return SharedSemaphore(made, _function(platform, "clReleaseSemaphoreKHR", _INT, _P))

    def wait(self, semaphore: SharedSemaphore) -> cl.Event:
        """Have the device's queue wait until Vulkan has signaled `semaphore`, which resets it, and return the event of
        that. All later work comes after it; the host goes on. Raises GffeError where the driver fails."""
        return self._call("clEnqueueWaitSemaphoresKHR", [_checked(semaphore)], (), None)

    def signal(self, semaphore: SharedSemaphore) -> cl.Event:
        """Signal `semaphore` for Vulkan once all work so far on the device's queue is complete, and return the event of
        that. Vulkan must wait for it before it is signaled again. Raises GffeError where the driver fails."""
        return self._call("clEnqueueSignalSemaphoresKHR", [_checked(semaphore)], (), None)

    def _move(self, command: str, buffers: Any, wait_for: Any) -> cl.Event:
        listed = require_list(buffers, cl.Buffer, "sharing: buffers", "a list of pyopencl.Buffers")
        return self._call(command, listed, wait_for)

    def _call(self, command: str, listed: list, wait_for: Any, *more: None) -> cl.Event:
        """Enqueue a command on buffers or semaphores, and return its event. `more`: its arguments after these."""
        queue = self.device.queue
        events = adopted_events(wait_for, self.device.context, "sharing: wait_for")
        optional, given = [_P] * len(more), (len(listed), _handles(listed), *more)
        call = _function(self.device.cl_device.platform, command, _INT, _P, _UINT, _P, *optional, _UINT, _P, _P)
        event = _P()
        error = call(queue.int_ptr, *given, len(events), _handles(events), ct.byref(event))
        _require_success(command, error)
        queue.flush()
        made: Any = event.value
        return cl.Event.from_int_ptr(made, retain=False)


class SharedSemaphore(Unique):
    """A semaphore of another API, made by `MemorySharing.semaphore`."""

    def __init__(self, handle: int, release: Callable):
        self.int_ptr, self._release = handle, release

    def __del__(self):
        self._release(self.int_ptr)


def _checked(semaphore: Any) -> SharedSemaphore:
    return require_kind(semaphore, SharedSemaphore, "sharing: semaphore", "one of MemorySharing.semaphore")


def _extensions(device: cl.Device) -> list[str]:
    return device.extensions.split()


def _handles(things: list) -> ct.Array | None:
    return (_P * len(things))(*(thing.int_ptr for thing in things)) if things else None


def _require_success(call: str, error: int) -> None:
    if error:
        raise GffeError(f"sharing: {call} failed: OpenCL error {error}")


@cache
def _loader() -> ct.CDLL:
    """Return the OpenCL loader that pyopencl is linked with. Its functions are found through pyopencl's own library."""
    library: Any = cl
    return ct.CDLL("OpenCL.dll" if sys.platform == "win32" else library._cl.__file__)


def _address(platform: cl.Platform, name: str) -> int | None:
    """Return the address of a function: of an extension from the driver, of others from the loader; None if there is
    none."""
    if not name.endswith("KHR"):
        with suppress(AttributeError):
            return ct.cast(getattr(_loader(), name), _P).value
    ask = _loader().clGetExtensionFunctionAddressForPlatform
    ask.restype, ask.argtypes = _P, [_P, ct.c_char_p]
    return ask(platform.int_ptr, name.encode())


def _function(platform: cl.Platform, name: str, result: Any, *arguments: Any) -> Callable:
    """Return a function of OpenCL by its name and types. Raises GffeError if neither driver nor loader has it."""
    address = _address(platform, name)
    if not address:
        raise GffeError(f"sharing: neither the driver {shown(platform.name)} nor the OpenCL loader has {name}")
    return ct.CFUNCTYPE(result, *arguments)(address)
