"""A provider of this package as a provider of Rigel 0.3."""

from __future__ import annotations

from typing import Any, ClassVar

from rigel_k8s.compat.found import command_line
from rigel_k8s.compat.words import LogReport, rigel_error
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.jobs.names import Builtin
from rigel_k8s.jobs.registry import provider_type
from rigel_k8s.rigelfile import load, realise


class ConnectionProvider:
    """A provider of rigel-k8s as a provider of Rigel; plugins find its connection by its name."""

    builtin: ClassVar[Builtin]
    identifier: str
    providers_data: dict[str, Any]

    def connect(self) -> None:
        """Connect with the options of the Rigelfile.

        Raises:
            RigelError: they are wrong, or it could not connect.
        """
        self._kind = provider_type(self.builtin.short)
        try:
            rigelfile = load(command_line().file)
            spec = rigelfile.providers[self.identifier]
            options = realise(rigelfile, spec, None, {}, self._kind.options).options
            connection = self._kind.connect(options, self.identifier, LogReport())
        except RigelK8sError as error:
            raise rigel_error(error) from error
        self.providers_data[self.identifier] = connection

    def disconnect(self) -> None:
        """Undo connect."""
        if self.identifier in self.providers_data:
            self._kind.disconnect(self.providers_data.pop(self.identifier))
