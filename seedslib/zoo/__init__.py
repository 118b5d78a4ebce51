"""The models of the papers, by name; each call builds a new system.

No results and no filters.

May import: base, models, delay, piecewise.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.zoo.continuous import flip_process as flip_process
    from seedslib.zoo.continuous import kicked_duffing as kicked_duffing
    from seedslib.zoo.continuous import linear_gaussian as linear_gaussian
    from seedslib.zoo.continuous import van_der_pol as van_der_pol
    from seedslib.zoo.delay import delayed_oscillator as delayed_oscillator
    from seedslib.zoo.delay import delayed_scalar as delayed_scalar
    from seedslib.zoo.delay import precise_sensor as precise_sensor
    from seedslib.zoo.delay import two_noises as two_noises
    from seedslib.zoo.piecewise import falling_body as falling_body
    from seedslib.zoo.switching import dependent_switching as dependent_switching
    from seedslib.zoo.switching import manoeuvring_target as manoeuvring_target
    from seedslib.zoo.switching import scalar_switching as scalar_switching
    from seedslib.zoo.switching import steady_target as steady_target
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
