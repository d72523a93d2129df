"""What intima raises. Texts are the engine's: they name the thing, the place and the size."""


class Error(Exception):
    """Something failed. The base of all others."""


class ArgumentError(Error, ValueError):
    """Arguments or settings that make no sense, or an array of the wrong form."""


class InputError(Error, ValueError):
    """An input that is not what the function needs: no lumen, no such organ, a broken file."""


class DeviceError(Error, RuntimeError):
    """There is no device that can do it: drawing needs Vulkan."""


class MemoryLimitError(Error, MemoryError):
    """It would take more memory than `max_memory` allows."""


class Cancelled(Error):
    """The work was cancelled by `Session.cancel`."""
