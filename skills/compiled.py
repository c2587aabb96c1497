"""The decorator of compiled functions whose code is kept on disk, and the cache that may fail without harm.

numba takes its cache to be infallible: a damaged entry raises, and so does a program folder that cannot be
written. Here an entry that cannot be read is compiled again and replaced, and code that cannot be written is not
kept. The code in a program folder that is read-only is still used. The code of an installed package goes to the
user's cache, because nothing would remove it from the package's folder.

Of several processes that need the same code, one compiles it. The others wait and load it (a file lock beside the
code). If that one ends early, the next one compiles.

Threads wait for a compilation on another thread, named COMPILER, so that the main thread handles a signal at once.
An exception of its handler leaves the other thread behind, and `abandon_compilation` ends the waits of the others.
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator
from concurrent.futures import Future, InvalidStateError, wait
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread, current_thread, main_thread
from typing import IO, Any, ClassVar

from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.core.event import trigger_event

from foldcell.skills.lean_compilation import lean_compilation

INSTALLED = frozenset({"site-packages", "dist-packages"})
WAITING = "foldcell:waiting"
"""Kind of the event while this process waits for code that another one compiles. Data: the function's `module`."""
COMPILER = "compiler"
"""Name of the threads that compile."""
AWAKE_S = 0.2
"""Time after which a waiting thread is awake for a moment [s], because the main thread does not notice a signal
that arrives just before it begins to wait."""
_awaited: dict[Future[Any], Thread] = {}
"""Result of each compilation -> the thread that waits for it."""


class _BesideSource(InTreeCacheLocator):
    """`__pycache__` beside the source, unless that belongs to an installed package."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        installed = not INSTALLED.isdisjoint(Path(py_file).parts)
        return None if installed else super().from_function(py_func, py_file)  # type: ignore[no-untyped-call]


class _UncheckedPlace(InTreeCacheLocator):
    """The folder beside the source, which may be read-only."""

    def ensure_cache_path(self) -> None:
        pass


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [  # noqa: RUF012
        *(_BesideSource if c is InTreeCacheLocator else c for c in CompileResultCacheImpl._locator_classes),
        _UncheckedPlace,
    ]


class FallibleCache(FunctionCache):
    """The code of one function on disk. Neither reading nor writing it raises."""

    _impl_class = _Implementation
    caches: ClassVar[list[FallibleCache]] = []
    """The caches of all functions that were imported."""
    _lock: IO[bytes] | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code. If there is none, lock it, so that this process compiles it; wait for another one that
        does. `unlocking` releases the lock."""
        found = self._loaded(sig, target_context)
        if found is None and self._lock is None:
            self._lock_file()
            found = self._loaded(sig, target_context)
        return found

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # damaged bytes raise anything
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(Exception):  # the compiled function is good, wherever it cannot be written
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    def _lock_file(self) -> None:
        with suppress(OSError):  # without a place for the file, each process compiles
            self._lock = self.index.with_suffix(".lock").open("ab")
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                with trigger_event(WAITING, {"module": self._py_func.__module__}):
                    fcntl.flock(self._lock, fcntl.LOCK_EX)

    @contextmanager
    def unlocking(self) -> Iterator[None]:
        """At the end, release the lock if it was locked within the block."""
        before = self._lock
        try:
            yield
        finally:
            if self._lock is not None and before is None:
                self._lock.close()
                self._lock = None

    @property
    def index(self) -> Path:
        return Path(self._cache_file._index_path)

    def check(self) -> int:
        """Load all entries and return their number. Raises any exception if one is damaged."""
        names = self._cache_file._load_index().values()
        for name in names:
            self._cache_file._load_data(name)
        return len(names)


def cached(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function with numba, without the interpreter's lock, and keeps its code
    on disk. options: further ones of `numba.njit`."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = njit(nogil=True, **options)(function)
        dispatcher._cache = cache = FallibleCache(function)  # type: ignore[no-untyped-call]
        FallibleCache.caches.append(cache)
        compile_now = dispatcher.compile

        def compile_once(signature: Any) -> Any:
            with lean_compilation(), cache.unlocking():
                return compile_now(signature)

        dispatcher.compile = _on_a_thread(compile_once)
        return dispatcher

    return compiled


def abandon_compilation() -> bool:
    """End the waits for compilations on all threads but the main thread: they raise a RuntimeError there. Return
    whether the main thread waits for a compilation."""
    for done, waiting in tuple(_awaited.items()):
        if waiting is not main_thread():
            with suppress(InvalidStateError):  # it is compiled
                done.set_exception(RuntimeError("code was being compiled when the process was asked to end"))
    return main_thread() in _awaited.values()


def _on_a_thread(compile_now: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def compile_there(signature: Any) -> Any:
        if global_compiler_lock.is_locked():  # by this thread, which compiles
            return compile_now(signature)
        done: Future[Any] = Future()

        def work() -> None:
            with suppress(InvalidStateError):  # abandoned
                try:
                    done.set_result(compile_now(signature))
                except BaseException as error:
                    done.set_exception(error)

        _awaited[done] = current_thread()
        try:
            Thread(target=work, name=COMPILER, daemon=True).start()
            while not wait([done], AWAKE_S).done:
                pass
            return done.result()
        finally:
            del _awaited[done]

    return compile_there
