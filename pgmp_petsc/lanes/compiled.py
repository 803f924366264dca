"""Compiled functions: numba's ``njit`` with a cache on disk whose loss costs time and never a run.

Numba itself ends with a traceback where it finds no folder that it may write to, where the disk is full, and where a
file of the cache is damaged. Here the function is compiled again, and the first such problem is kept for a warning.

Numba looks at the file of a function alone, and would take up code into which a function of another file was compiled
before that one changed, as after an update of a checkout: wrong numbers without a word. What is kept is therefore
marked by all that is compiled into it: the code of the functions that it calls, one after the other, and the values of
the names that they read. Words, and functions that it does not call, may change.

Processes that compile at once may also write two signatures of one function to the same file; numba would call the
wrong one. What is loaded is therefore compared with what was asked for. What Python calls, and what is apart, is
compiled by one process at a time; others wait, and load it.

A wheel may carry what `scripts/wheel` compiled for families of processors (`CARRIED`). A processor of the family loads
it; where numba or the processor is another, functions are compiled as in a checkout, and a warning says so.

Compiling takes minutes where a run takes seconds: while it goes on, the counts of progress say so.

Machine code that is made of what is called by its address, and of nothing else.

Numba optimises each function that it compiles, and makes machine code of it, though most are only ever copied into
others and optimised there once more: code that is five calls deep is optimised and translated five times. Here a
function is linked with what it calls, and that is all until somebody asks for its address.

Before that numba passes over all of a function for each of its variables, which takes it a third of the time of a long
one. Here it passes over the blocks that have the variable, and finds the same. It also asks LLVM for the size of each
variable that is made, with a module for each question; here once for each type.
"""

from __future__ import annotations

import ctypes
import fcntl
import functools
import gc
import hashlib
import inspect
import itertools
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numba
import numpy as np
from llvmlite import binding, ir
from numba.core import (
    analysis,
    base,
    cgutils,
    codegen,
    environment,
    errors,
    event,
    extending,
    imputils,
    sigutils,
    ssa,
    types,
    typing,
)
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import _nrt_python

from pgmp_petsc.base.progress import waits_for

CURE = "set NUMBA_CACHE_DIR to a folder with space that can be written"
COMPILING = "compiling, once for scenes of this kind"
PATIENCE = 300.0  # s, for what another process compiles
# Python looks through what was made for what it may collect after so many new objects, ten and so many such times: what
# numba makes stays until a function is compiled, and looking took a twelfth of the time
COLLECTIONS = (100_000, 20, 50)
MAKE = "pgmp_make"  # what compiled code has a function apart made by
PACKAGE = Path(__file__).parent.parent
#: Of a wheel with compiled code: the version of numba, and processors as numba's cache names them, the best one first.
CARRIED = Path(__file__).with_name("carried.json")
LIBRARIES = ("numpy", "numba", "math")  # numba knows their functions; its version marks its files
_problems: list[str] = []
#: Of functions apart: the word with their address, module, function and types of the arguments, by name.
_slots: dict[str, tuple[ctypes.c_void_p, str, str, tuple]] = {}
_called_by_address: list[Any] = []


def njit(
    *, cache: bool = False, counted: bool = True, entry: bool = False, apart: Any = None, **options: Any
) -> Callable[[Callable], Callable]:
    """Return numba's decorator with the same options; a cache that fails is done without.

    A function that neither makes nor returns arrays can do without `counted` references to them; they took 40 % of the
    steps of reduced models. An `entry` is called from Python alone: what other compiled functions would take it up from
    is not kept in the cache, as reading that is most of what loading a large function takes.

    Of what a function calls numba takes a copy into it, and optimises that again: code that is five calls deep is
    compiled five times, and all that could be called is compiled. A function `apart` is compiled, or loaded, when it is
    first called, once for each set of types: what a scene has not is not compiled. Such a call takes a nanosecond and
    1.4 for each array among its arguments, so that it is for functions that do much. `apart` is True where nothing is
    returned, else the type of what is, or what gives it from the types of the arguments.

    What lets Python call a function, arguments taken from their objects and the function once more, is compiled for
    entries, and for others where Python calls them: without it, `linked`, other functions call them.
    """

    def decorate(function: Callable) -> Callable:
        # nothing here is called from C; the wrapper for that would be compiled with each function. Whether references
        # are counted is said in either case: a function takes it from its first caller otherwise
        dispatcher = numba.njit(no_cfunc_wrapper=True, _nrt=counted, **options)(function)
        dispatcher.apart = apart
        if numba.config.DISABLE_JIT:
            return dispatcher
        dispatcher._compilation_chain_init_hook = _no_extensions
        kind = _EntryCache if entry or apart else _LenientCache
        if cache:
            kind(function).serve(dispatcher)
        if entry:
            return dispatcher

        @functools.cache  # few functions of those that are loaded are compiled, or typed
        def linked() -> Any:
            found = numba.njit(no_cfunc_wrapper=True, no_cpython_wrapper=True, _nrt=counted, **options)(function)
            found._compilation_chain_init_hook = _no_extensions
            if cache:
                kind(function, "-linked").serve(found)
            return found

        dispatcher.linked = linked
        dispatcher.get_call_template = lambda *args: linked().get_call_template(*args)
        dispatcher.get_overload = lambda *args: linked().get_overload(*args)
        if apart:
            dispatcher.get_call_template = functools.partial(_call_template, linked, apart)
            dispatcher.get_overload = functools.partial(_call_of, linked, apart)
        return dispatcher

    return decorate


class NotCompiledError(RuntimeError):
    """A function could not be compiled when it was called; why is written to standard error."""


def _call_template(linked: Any, returns: Any, args: tuple, kws: dict) -> tuple:
    """Return the signature of a call of a function apart, in numba's form; nothing is compiled."""
    pysig, folded = linked()._compiler.fold_argument_types(args, kws)
    takes = tuple(types.unliteral(one) for one in folded)
    signature = typing.signature(_returned(returns, takes), *takes)
    name = linked().py_func.__name__
    return typing.make_concrete_template(name, key=name, signatures=[signature]), pysig, folded, {}


def _returned(returns: Any, takes: tuple) -> types.Type:
    if returns is True:
        return types.none
    return returns if isinstance(returns, types.Type) else returns(*takes)


def _call_of(linked: Any, returns: Any, signature: Any) -> Any:
    """Return the key of what numba lowers a call of a function apart by."""
    linked, arguments = linked(), tuple(sigutils.normalize_signature(signature)[0])
    returned = _returned(returns, arguments)
    function = linked.py_func
    text = f"{function.__module__}.{function.__qualname__}{arguments}"
    key = f"{function.__qualname__}:{hashlib.sha256(text.encode()).hexdigest()}"
    _make_slot(key, function.__module__, function.__qualname__, arguments)
    if not linked.targetctx._defns[key].versions:

        def call(context: Any, builder: ir.IRBuilder, sig: Any, args: Sequence) -> ir.Value:
            return _lower_call(context, builder, key, returned, arguments, args)

        call.signature, call.libs = arguments, ()
        linked.targetctx._defns[key].append(call, call.signature)
    return key


def _lower_call(
    context: Any, builder: ir.IRBuilder, key: str, returned: types.Type, takes: tuple, args: Sequence
) -> ir.Value:
    """Write the call of what the word of a function apart points to, which is compiled if it points nowhere."""
    pointer = ir.IntType(8).as_pointer()
    word = builder.module.globals.get(key) or ir.GlobalVariable(builder.module, pointer, key)
    with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(word))):
        make = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.IntType(32), [pointer.as_pointer()]), MAKE
        )
        status = builder.call(make, [word])
        for number, error in enumerate((NotCompiledError, KeyboardInterrupt), 1):
            with cgutils.if_unlikely(builder, builder.icmp_signed("==", status, ir.IntType(32)(number))):
                context.call_conv.return_user_exc(builder, error, ())
    kind = context.call_conv.get_function_type(returned, takes)
    function = builder.bitcast(builder.load(word), kind.as_pointer())
    status, value = context.call_conv.call_function(builder, function, returned, takes, args)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return imputils.impl_ret_new_ref(context, builder, returned, value)


def _make_slot(key: str, module: str, function: str, arguments: tuple) -> None:
    """Make known where compiled code finds the address of a function apart."""
    if not _slots:
        binding.add_symbol(MAKE, ctypes.cast(_make, ctypes.c_void_p).value)
    if key not in _slots:
        _slots[key] = ctypes.c_void_p(), module, function, arguments
        binding.add_symbol(key, ctypes.addressof(_slots[key][0]))


@ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
def _make(address: int) -> int:
    """Compile, or load, the function apart whose word has an address; return 0, or which exception to raise."""
    try:
        word, module, name, arguments = next(one for one in _slots.values() if ctypes.addressof(one[0]) == address)
        linked = getattr(import_module(module), name).linked()
        linked.compile(arguments)
        made = linked.overloads[arguments]
        word.value = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
    except KeyboardInterrupt:
        return 2
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def native_address(function: Callable, result: Any, takes: tuple) -> int:
    """Compile a function of numba's types and return where its machine code is: compiled code may call it from there.

    The function is kept alive with the process.
    """
    dispatcher = njit(cache=True, entry=True, counted=False, error_model="numpy")(function)
    dispatcher.compile(result(*takes))
    _called_by_address.append(dispatcher)
    made = dispatcher.overloads[takes]
    return made.library.get_pointer_to_function(made.fndesc.llvm_func_name)


def cache_problem() -> str | None:
    """Return what the first problem with the cache was in this process, with its cure, or None."""
    return _problems[0] if _problems else None


def _no_extensions() -> None:
    """Ask no other package for types of its own: there are none here, and numba would look through all that are
    installed."""


class _ByName(CompileResultCacheImpl):
    """Keeps a function under its name, whichever line of its file it begins in."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Return what the names of its files begin with."""
        fullname = fullname.replace("<", "").replace(">", "")
        return f"{fullname}.{sys.implementation.cache_tag}{abiflags}"


class _LenientCache(FunctionCache):
    """The cache of one function; what cannot be read counts as absent, what cannot be written stays away.

    Its folder is looked for when it is first asked for something: most functions are parts of others, which bring them
    along, and looking for a folder tries to write there.
    """

    _impl_class = _ByName

    def __init__(self, function: Callable, ending: str = "") -> None:
        self._function, self._ending, self._is_open = function, ending, False

    def serve(self, dispatcher: Dispatcher) -> None:
        """Be the cache of a function."""
        dispatcher._cache = self

    def _open(self) -> bool:
        """Look for the folder to write to, unless that was done; return whether there is one."""
        if not self._is_open:
            self._is_open, self._enabled = True, False
            try:
                super().__init__(self._function)
                mark = compiled_mark(self._function)
                beside = os.path.join(os.path.dirname(inspect.getfile(self._function)), "__pycache__")
                name = self._impl.filename_base + self._ending
                self._files = [
                    IndexDataCacheFile(path, name, mark) for path in dict.fromkeys((self._cache_path, beside))
                ]
                self._cache_file = self._files[0]
            except (RuntimeError, OSError) as error:  # no locator has a folder
                _note(f"compiled code is not kept, and every run compiles for minutes ({_first(error)}); {CURE}")
        return self._enabled

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function of a signature, or None.

        Numba would first load all that it can compile, which takes longer than all else here together, and compile its
        counting of references. What is compiled already has that in it, and calls the allocation of arrays alone; where
        something is to be compiled, numba loads the rest.
        """
        if not self._open():
            return None
        _register_allocation()
        signature, own, code = self._index_key(sig, target_context.codegen())
        for processors in (lambda: (own,), lambda: _carried(own[0])):
            for processor, file in itertools.product(processors(), self._files):
                found = self._kept_in(file, (signature, processor, code), target_context)
                if found is not None and tuple(found.signature.args) == tuple(sigutils.normalize_signature(sig)[0]):
                    return found
        return None

    def _kept_in(self, file: IndexDataCacheFile, key: tuple, target_context: Any) -> Any:
        """Return what a file of the folder to write to, or of the one beside the source, has; None where that is
        nothing, or damaged."""
        try:
            name = file._load_index().get(key)
            if name and os.path.exists(file._data_path(name)):
                with _bare_environments():
                    return self._impl.rebuild(target_context, file._load_data(name))
        except (ModuleNotFoundError, AttributeError):  # of a class that an older version had in another place
            _forget(file)
        except Exception as error:  # a damaged pickle raises anything, and so does one of classes of another version
            can = "that cannot be read are written anew" if _forget(file) else "cannot be read, nor written anew"
            _note(f"files in {os.path.dirname(file._index_path)} {can} ({_first(error)})")
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the compiled function of a signature."""
        if not self._open():
            return
        try:
            # what makes known the functions apart that compiled code calls
            names = [one.name for one in data.library._final_module.global_variables if one.name in _slots]
            before = [functools.partial(_make_slot, name, *_slots[name][1:]) for name in names]
            super().save_overload(sig, data._replace(reload_init=[*data.reload_init, *before]))
        except Exception as error:  # a damaged index is read here too
            _note(f"compiled code is not kept in {self.cache_path} ({_first(error)}); {CURE}")


def _forget(file: IndexDataCacheFile) -> bool:
    """Empty an index, so that the next function kept starts another one; return whether that went well."""
    try:
        file.flush()
    except OSError:
        return False  # keeping a function there will fail too, and say so
    return True


@functools.cache
def _carried(machine: str) -> tuple[tuple[str, str, str], ...]:
    """Return the processors, as numba's cache names them, whose code of a wheel runs here."""
    if numba.config.CPU_NAME is not None or not CARRIED.exists():
        return ()
    wheel = json.loads(CARRIED.read_text(encoding="utf-8"))
    here = set(codegen.get_host_cpu_features().split(","))
    found = tuple((*one,) for one in wheel["processors"] if one[0] == machine and here >= set(one[2].split(",")))
    if not found or wheel["numba"] != numba.__version__:
        names = " and ".join(name for _, name, _ in wheel["processors"])
        _note(
            f"the wheel's compiled code is of numba {wheel['numba']} for processors {names}, and this is numba "
            f"{numba.__version__} on {binding.get_host_cpu_name()}: what runs need is compiled once, and takes minutes"
        )
    return found


def compiled_mark(function: Callable) -> str:
    """Return what tells all that is compiled into a function of the package.

    That is the code of the functions that it calls, one after the other, and the values of the names that they read. Of
    a function apart only its name and what it returns are compiled into its callers. What teaches numba types of the
    package is known to all.
    """
    marks: dict[Callable, str] = {}
    todo = [function]
    while todo:
        each = todo.pop()
        if each not in marks:
            own, called = _own_mark(each)
            marks[each] = f"{each.__module__}.{each.__qualname__} {own}"
            todo.extend(called)
    return _checksum(text_mark(*_teaching()), *sorted(marks.values()))


@functools.cache
def text_mark(*modules: str) -> str:
    """Return what tells the texts of modules of the package."""
    return _checksum(*(_text_of(name) for name in modules))


def _checksum(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@functools.cache
def _text_of(module: str) -> str:
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py").read_text(encoding="utf-8")


@functools.cache
def _teaching() -> tuple[str, ...]:
    """Return the modules of this room that teach numba types, or how something of them is compiled."""
    room = __name__.rpartition(".")[0]
    names = sorted(f"{room}.{path.stem}" for path in Path(__file__).parent.glob("*.py"))
    return tuple(name for name in names if "numba.extending import" in _text_of(name))


@functools.cache
def _own_mark(function: Callable) -> tuple[str, tuple[Callable, ...]]:
    """Return what tells a function's own code and the values that it reads, and which functions it calls."""
    called: list[Callable] = []
    codes, parts = [function.__code__], [repr(function.__defaults__)]
    names: set[str] = set()
    while codes:
        code = codes.pop()
        words = code.co_consts[1:] if code.co_consts[:1] == (function.__doc__,) else code.co_consts
        codes += [each for each in words if isinstance(each, CodeType)]
        parts += [code.co_code.hex(), repr([each for each in words if not isinstance(each, CodeType)])]
        parts += [repr(code.co_names), repr(code.co_varnames)]
        names.update(code.co_names)
    held = {name: function.__globals__[name] for name in names if name in function.__globals__}
    held |= inspect.getclosurevars(function).nonlocals
    for name, value in sorted(held.items()):
        values = [value]
        if isinstance(value, ModuleType) and value.__name__.startswith(f"{PACKAGE.name}."):
            values = [getattr(value, each) for each in sorted(names) if hasattr(value, each)]
        parts += [name, *(_read(each, called) for each in values)]
    return _checksum(*parts), tuple(called)


def _read(value: Any, called: list[Callable]) -> str:
    """Return what tells a value that compiled code reads; a function that it calls is added to `called`."""
    if isinstance(value, Dispatcher):
        options = repr(sorted(value.targetoptions.items()))
        if value.apart is None:
            called.append(value.py_func)
            return options
        return f"{value.py_func.__module__} {options} {_read(value.apart, called)}"
    if isinstance(value, FunctionType) and value.__module__.partition(".")[0] not in LIBRARIES:
        called.append(value)
        return value.__qualname__
    if isinstance(value, tuple | list):
        return repr([_read(each, called) for each in value])
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, extending._Intrinsic):
        return text_mark(value._defn.__module__)
    if isinstance(value, type):
        return f"{value.__module__}.{value.__qualname__} {getattr(value, '_fields', '')}"
    if isinstance(value, ModuleType | BuiltinFunctionType | FunctionType | np.ufunc):
        return value.__name__
    if isinstance(value, np.generic):
        return f"{value.dtype} {value.item()!r}"
    if isinstance(value, bool | int | float | complex | str | None | np.dtype | types.Type):
        return repr(value)
    raise TypeError(f"nothing tells changes of {value!r}, which compiled code reads")


@functools.cache
def _register_allocation() -> None:
    """Make known where numba's allocation of arrays is, as it does when it begins to compile."""
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@contextmanager
def _bare_environments() -> Iterator[None]:
    """Let no module of numba's be imported for what is loaded within the block.

    Numba wants the globals of all that was compiled into a function, and imports what it compiles array functions with
    to have them. Only code that was not compiled looks globals up, of which there is none here.
    """
    rebuild = environment._rebuild_env

    def bare(module: str, constants: Sequence, name: str) -> environment.Environment:
        found = environment.lookup_environment(name)
        if found is not None or not module.startswith("numba."):
            return rebuild(module, constants, name)
        made = environment.Environment({"__name__": module})
        made.consts[:], made.env_name = constants, name
        environment.Environment._memo[name] = made
        return made

    environment._rebuild_env = bare
    try:
        yield
    finally:
        environment._rebuild_env = rebuild


class _NamesAlone(_ByName):
    """Keeps the machine code of a function, and of its intermediate code the names that are defined."""

    def reduce(self, cres: Any) -> tuple:
        """Return what is kept."""
        cres.library.make()
        (name, kind, (machine_code, bitcode)), *rest = super().reduce(cres)
        module = binding.parse_bitcode(bitcode)
        defined = [function.name for function in module.functions if not function.is_declaration]
        text = "\n".join(f'define void @"{each}"() {{ ret void }}' for each in defined)
        return (name, kind, (machine_code, binding.parse_assembly(text).as_bitcode())), *rest


class _EntryCache(_LenientCache):
    """The cache of a function that Python alone calls, or of one apart; what one process compiles, others wait for."""

    _impl_class = _NamesAlone
    _lock: int | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function of a signature, or None, and then no other process compiles it."""
        found = super().load_overload(sig, target_context)
        if found is None and self._enabled:
            self._take_lock()
            found = super().load_overload(sig, target_context)
        return found

    def serve(self, dispatcher: Dispatcher) -> None:
        """Be the cache of a function, which lets others compile once it is compiled, loaded, or cannot be."""
        super().serve(dispatcher)
        compile_it = dispatcher.compile

        def compile_alone(sig: Any) -> Any:
            try:
                return compile_it(sig)
            finally:
                self._give_back_lock()

        dispatcher.compile = compile_alone

    def _take_lock(self) -> None:
        """Wait until no other process compiles the function.

        Where there are no locks, or another takes too long, it is compiled twice.
        """
        try:
            self._impl.locator.ensure_cache_path()
            lock = os.open(self._cache_file._index_path.removesuffix("nbi") + "lock", os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return
        self._lock, until = lock, time.monotonic() + PATIENCE
        while time.monotonic() < until:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                time.sleep(0.02)
            except OSError:
                return

    def _give_back_lock(self) -> None:
        """Let others compile."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


ENVIRONMENT = "_ZN08NumbaEnv"  # what the names of globals with the surroundings of functions begin with


class Library(codegen.JITCodeLibrary):
    """The code of one function and of all that it calls."""

    _is_machine_code = False

    @property
    def codegen(self) -> Library:
        """Return what numba tells the surroundings of functions to."""
        return self

    def set_env(self, name: str, surroundings: environment.Environment) -> None:
        """Take the surroundings of a function, unless nothing runs yet that could ask for them."""
        if self._is_machine_code:
            self._codegen.set_env(name, surroundings)

    def finalize(self) -> None:
        """Link with what is called."""
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_final_module()

    def _finalize_final_module(self) -> None:
        """End the linking; code that was loaded is made ready at once."""
        if self._object_caching_enabled and self._compiled_object is not None:
            self._is_machine_code = True
            super()._finalize_final_module()
        self._finalized = True

    def make(self) -> None:
        """Optimise, and make machine code."""
        self._ensure_finalized()
        if self._is_machine_code:
            return
        self._is_machine_code = True
        self._optimize_final_module()
        self._final_module.verify()
        super()._finalize_final_module()
        for variable in self._final_module.global_variables:
            if variable.name.startswith(ENVIRONMENT):
                surroundings = environment.lookup_environment(variable.name)
                if surroundings is not None:
                    self._codegen.set_env(variable.name, surroundings)

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function of this code, 0 if there is none."""
        self._ensure_finalized()
        if not self._is_machine_code and any(one.name == name for one in self.get_defined_functions()):
            self.make()
        return super().get_pointer_to_function(name)

    def serialize_using_object_code(self) -> tuple:
        """Return what is kept: without machine code where nobody asked for it."""
        return super().serialize_using_object_code() if self._is_machine_code else self.serialize_using_bitcode()


def _shorten_analyses() -> None:
    """Let numba look for a variable where it is, and nowhere else, and ask for the size of a type once."""
    live_map, in_ssa, rewritten = analysis.compute_live_map, ssa._run_ssa, ssa._run_block_rewrite
    size_of, sizes = base.BaseContext.get_abi_sizeof, dict[ir.Type, int]()
    names: dict[int, set[str]] = {}  # of the variables of each block

    def get_abi_sizeof(context: Any, kind: ir.Type) -> int:
        """Return how many bytes a variable of a type takes."""
        if kind not in sizes:
            sizes[kind] = size_of(context, kind)
        return sizes[kind]

    def compute_live_map(graph: Any, blocks: dict, used: dict[int, set], defined: dict[int, set]) -> dict[int, set]:
        """Return the variables that live on into each block; such are used in a block that does not define them."""
        crossing = set().union(*used.values())
        return live_map(graph, blocks, used, {label: own & crossing for label, own in defined.items()})

    def run_ssa(blocks: dict) -> dict:
        """Return blocks in which each variable is assigned once; rewriting a variable brings no other to a block."""
        names.clear()
        for label, block in blocks.items():
            names[label] = {variable.name for each in block.body for variable in each.list_vars()}
        return in_ssa({label: block.copy() for label, block in blocks.items()})

    def rewrite(blocks: dict, states: dict, handler: Any) -> dict:
        """Return blocks with the variable at hand rewritten."""
        own = {label: block for label, block in blocks.items() if states["varname"] in names[label]}
        return blocks | rewritten(own, states, handler)

    analysis.compute_live_map, ssa._run_ssa, ssa._run_block_rewrite = compute_live_map, run_ssa, rewrite
    base.BaseContext.get_abi_sizeof = get_abi_sizeof


class _Compiling(event.Listener):
    """Tells the counts of progress when something is compiled, and lets Python seldom collect meanwhile."""

    def __init__(self) -> None:
        self._usual: list[tuple[int, int, int]] = []  # of each function that is being compiled, within one another

    def on_start(self, _: event.Event) -> None:
        """Say that it began."""
        waits_for(COMPILING)
        self._usual.append(gc.get_threshold())
        gc.set_threshold(*COLLECTIONS)

    def on_end(self, _: event.Event) -> None:
        """Say no more."""
        waits_for(None)
        gc.set_threshold(*self._usual.pop())


event.register("numba:compile", _Compiling())
_shorten_analyses()
# errors that numba makes and catches, thousands of them, would open a terminal each to be coloured
errors._termcolor_inst = SimpleNamespace(
    **dict.fromkeys(("code", "errmsg", "filename", "highlight", "indicate", "reset"), str)
)
codegen.JITCPUCodegen._library_class = Library


def _note(problem: str) -> None:
    _problems.append(problem)


def _first(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0] or type(error).__name__
