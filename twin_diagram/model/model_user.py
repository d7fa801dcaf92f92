"""The one way to hand a corrected model on: systems that take it in while a Diagram runs.

Each keeps what it made of every model it was given, numbered from 0, the one it was built with. Which of them a Context
uses is a numeric parameter of that Context, so that Contexts of one Diagram may use different models, and a copy of a
Context goes on with its own.
"""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram.model.model import Model

Made = TypeVar("Made")
"""What a system makes of a model: a filter, a monitor, the model itself."""


class ModelUser(LeafSystem, Generic[Made]):
    """A system whose model may be corrected while it runs.

    A subclass says in `_make` what it makes of a model, and in `_hand_over` what of its state goes over to it; its
    constructor calls `_begin_with` once.
    """

    def add_model(self, model: Any) -> int:
        """Take in a corrected model of the same arm; answer its number, by which `use_model` calls it.

        No Context uses it yet.

        Args:
            model: a `Model`, or whatever else the system was made with.

        Raises:
            ModelError, ScenarioError: the system cannot use it, or it is of another arm.
        """
        self._made.append(self._make(model))
        return len(self._made) - 1

    def use_model(self, context: Context, number: int) -> None:
        """Go on with another model in this Context.

        Args:
            context: this system's own, at rest: between two steps of a simulator.
            number: as `add_model` gave it; 0 is the model that the system was made with.

        Raises:
            IndexError: there is no such model.
        """
        if not 0 <= number < len(self._made):
            raise IndexError(f"model {number}: there are {len(self._made)}")
        self._hand_over(context, self._made[number])
        context.get_mutable_numeric_parameter(self._number).SetAtIndex(0, float(number))

    def model_number(self, context: Context) -> int:
        """Return which model this Context uses."""
        return int(context.get_numeric_parameter(self._number).GetAtIndex(0))

    # For subclasses.

    def _begin_with(self, made: Made) -> None:
        """Declare the parameter; what was made of the given model has number 0."""
        self._made = [made]
        self._number = self.DeclareNumericParameter(BasicVector([0.0]))

    def _in_use(self, context: Context) -> Made:
        """Return what was made of the model that this Context uses."""
        return self._made[self.model_number(context)]

    def _make(self, model: Model) -> Made:
        """Return what the system needs of a model."""
        raise NotImplementedError

    def _hand_over(self, context: Context, made: Made) -> None:
        """Carry what the system knows in a Context over to what was made of another model; nothing here."""
