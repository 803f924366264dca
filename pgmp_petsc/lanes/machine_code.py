"""Machine code that is made of what is called by its address, and of nothing else.

Numba optimises each function that it compiles, and makes machine code of it, though most are only ever copied into
others and optimised there once more: code that is five calls deep is optimised and translated five times. Here a
function is linked with what it calls, and that is all until somebody asks for its address.
"""

from __future__ import annotations

from numba.core import codegen, environment

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
