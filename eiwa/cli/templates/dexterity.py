"""The dexterity index mydevice: how well the tip moves, less near joint limits. Put your own formula in its place."""

from collections.abc import Sequence
from dataclasses import dataclass

from eiwa.core.hookspecs import Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import ArmColumns, TracedIndex
from eiwa.core.linear import product, volume
from eiwa.core.symbols import Column


class MydeviceParameters(Parameters):
    """Volume of the velocity ellipsoid of the tip, times the distance from joint limits."""

    penalty: bool = quantity(True, description="Whether joints near their limits count less.")


@dataclass(frozen=True)
class Mydevice(TracedIndex):
    """sqrt det(Jv Jvt) prod_j 4 u_j (1 - u_j), written on columns: eiwa compiles it together with the arm."""

    parameters: MydeviceParameters

    @property
    def structure(self) -> bool:  # type: ignore[override]
        """What changes the formula itself."""
        return self.parameters.penalty

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """The value of a posture: not negative, not normalised."""
        margins = [4.0 * u * (1.0 - u) for u, limited in zip(arm.u, arm.limited, strict=True) if limited]
        return volume(arm.jacobian[:3]) * product(margins if self.parameters.penalty else [])


@hookimpl
def eiwa_dexterities() -> list[Plugin]:
    """The name that a study writes in kind, the table's model, and what builds the index from it."""
    return [Plugin("mydevice", MydeviceParameters, Mydevice)]
