"""Lists Vulkan devices through the loader's C interface: no package, no SAPIEN, and the driver's version with it.

Run it in a process of its own (`python -m lerobot_adamanip.cli.doctor.vulkan_devices`): a broken driver may crash.
"""

from __future__ import annotations

import ctypes
import json
import sys
from typing import Any

_TYPES = ("other", "integrated GPU", "discrete GPU", "virtual GPU", "cpu")
_VULKAN_1_2 = (1 << 22) | (2 << 12)
# VkStructureType of the four structures below.
_APPLICATION_INFO, _INSTANCE_CREATE_INFO, _PROPERTIES_2, _DRIVER_PROPERTIES = 0, 1, 1000059001, 1000196000


class _ApplicationInfo(ctypes.Structure):
    _fields_ = (
        ("sType", ctypes.c_uint32),
        ("pNext", ctypes.c_void_p),
        ("pApplicationName", ctypes.c_char_p),
        ("applicationVersion", ctypes.c_uint32),
        ("pEngineName", ctypes.c_char_p),
        ("engineVersion", ctypes.c_uint32),
        ("apiVersion", ctypes.c_uint32),
    )


class _InstanceCreateInfo(ctypes.Structure):
    _fields_ = (
        ("sType", ctypes.c_uint32),
        ("pNext", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("pApplicationInfo", ctypes.POINTER(_ApplicationInfo)),
        ("enabledLayerCount", ctypes.c_uint32),
        ("ppEnabledLayerNames", ctypes.c_void_p),
        ("enabledExtensionCount", ctypes.c_uint32),
        ("ppEnabledExtensionNames", ctypes.c_void_p),
    )


class _DriverProperties(ctypes.Structure):
    _fields_ = (
        ("sType", ctypes.c_uint32),
        ("pNext", ctypes.c_void_p),
        ("driverID", ctypes.c_uint32),
        ("driverName", ctypes.c_char * 256),
        ("driverInfo", ctypes.c_char * 256),
        ("conformanceVersion", ctypes.c_uint8 * 4),
    )


class _Properties2(ctypes.Structure):
    # VkPhysicalDeviceProperties has 824 bytes, of which the first 276 are read; the rest has to be there.
    _fields_ = (
        ("sType", ctypes.c_uint32),
        ("pNext", ctypes.c_void_p),
        ("apiVersion", ctypes.c_uint32),
        ("driverVersion", ctypes.c_uint32),
        ("vendorID", ctypes.c_uint32),
        ("deviceID", ctypes.c_uint32),
        ("deviceType", ctypes.c_uint32),
        ("deviceName", ctypes.c_char * 256),
        ("rest", ctypes.c_char * 1024),
    )


def _describe(loader: Any, handle: int | None) -> dict[str, str]:
    driver = _DriverProperties(sType=_DRIVER_PROPERTIES)
    found = _Properties2(sType=_PROPERTIES_2, pNext=ctypes.addressof(driver))
    loader.vkGetPhysicalDeviceProperties2(ctypes.c_void_p(handle), ctypes.byref(found))
    return {
        "name": found.deviceName.decode(errors="replace"),
        "type": _TYPES[found.deviceType] if found.deviceType < len(_TYPES) else _TYPES[0],
        "driver": f"{driver.driverName.decode(errors='replace')} {driver.driverInfo.decode(errors='replace')}".strip(),
    }


def list_devices() -> list[dict[str, str]]:
    """Name, type and driver (with its version) of every Vulkan device.

    Raises:
        OSError: the Vulkan loader is not installed, or no driver answers; the message says which.
    """
    loader: Any = ctypes.CDLL("libvulkan.so.1")
    instance = ctypes.c_void_p()
    application = _ApplicationInfo(sType=_APPLICATION_INFO, apiVersion=_VULKAN_1_2)
    request = _InstanceCreateInfo(sType=_INSTANCE_CREATE_INFO, pApplicationInfo=ctypes.pointer(application))
    code = loader.vkCreateInstance(ctypes.byref(request), None, ctypes.byref(instance))
    if code != 0:
        raise OSError(f"vkCreateInstance failed with {code}: no driver (ICD) is installed, or none could be loaded")
    count = ctypes.c_uint32()
    loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    handles = (ctypes.c_void_p * count.value)()
    loader.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
    devices = [_describe(loader, handle) for handle in handles[: count.value]]
    loader.vkDestroyInstance(instance, None)
    return devices


if __name__ == "__main__":
    try:
        print(json.dumps(list_devices()))
    except OSError as error:
        sys.exit(str(error))
