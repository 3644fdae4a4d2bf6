"""Arrays as CuPy, JAX and PyTorch have them on a card, of a fake driver's memory."""

import numpy as np

from pgm.kernels import dlpack


class CudaArray:
    """An array on a card, by the CUDA array interface; `turned` lies with the runs fastest."""

    def __init__(self, driver, array, *, turned=False, **told):
        array = np.asarray(array)
        lies = np.ascontiguousarray(np.moveaxis(array, 0, -1) if turned else array)
        driver.contexts.append("of another library")
        error, self.place = driver.cuMemAlloc(lies.nbytes)
        assert not error
        driver.cuMemcpyHtoD(self.place, lies.ctypes.data, lies.nbytes)
        driver.contexts.pop()
        self.driver, self.shape, self.kind = driver, array.shape, lies.dtype.str
        self.strides = (np.moveaxis(lies, -1, 0) if turned else lies).strides
        self.told = {"strides": self.strides if turned else None, **told}

    @property
    def __cuda_array_interface__(self):
        return {
            "shape": self.shape,
            "typestr": self.kind,
            "data": (self.place, False),
            "version": 3,
            **self.told,
        }

    def write(self, array):
        """Write other numbers into an array that is not turned."""
        array = np.ascontiguousarray(array)
        self.driver.cuMemcpyHtoD(self.place, array.ctypes.data, array.nbytes)


class DlpackArray:
    """The same by DLPack alone."""

    def __init__(self, driver, array, **options):
        self.own = CudaArray(driver, array, **options)

    def __dlpack_device__(self):
        return dlpack.CUDA, 0

    def __dlpack__(self):
        own = self.own
        return dlpack.capsule(own.place, own.shape, own.strides, (dlpack.CUDA, 0), own)
