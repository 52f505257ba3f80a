from gn0.device.device import Device as Device
from gn0.device.device import DeviceArray as DeviceArray
from gn0.device.device import KernelSource as KernelSource
from gn0.device.dlpack import wrap_array as wrap_array
from gn0.device.open import find_device as find_device
from gn0.device.open import open_device as open_device
