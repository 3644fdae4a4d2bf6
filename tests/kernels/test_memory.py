"""Kernels that Python calls are kept on disk, where there is a folder that can be written to."""

import pytest

caching = pytest.importorskip("numba.core.caching", reason="kernels are compiled by Numba")


@pytest.mark.parametrize("writable", [True, False])
def test_a_kernel_needs_no_folder_to_be_kept_in(writable, monkeypatch, caplog):
    from pgm.kernels.compiled import store
    from pgm.kernels.compiled.memory import kept

    if not writable:

        def refuse(locator):
            raise OSError("read-only")

        for kind in vars(caching).values():
            if "ensure_cache_path" in getattr(kind, "__dict__", ()):
                monkeypatch.setattr(kind, "ensure_cache_path", refuse)
    store.tell.cache_clear()
    kernel = kept(lambda x: x + 1.0, "risen")
    assert kernel(1.0) == 2.0
    assert isinstance(kernel._cache, caching.FunctionCache) is writable
    if not writable:
        assert kernel._cache.cache_path is None
        assert "in each process anew" in caplog.text
