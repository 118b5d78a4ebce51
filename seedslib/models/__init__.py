"""What is observed: jump-diffusions, switching systems, discrete systems.

With their noise, their maps compiled from SymPy, their simulation and their chains on a grid. A
model knows no filter and no estimate.

May import: base, gaussian.
"""

from seedslib.base.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from seedslib.models.chains import GridChain as GridChain
    from seedslib.models.chains import PlaneChain as PlaneChain
    from seedslib.models.chains import grid_chain as grid_chain
    from seedslib.models.discrete import DiscreteSystem as DiscreteSystem
    from seedslib.models.jump_diffusion import JumpDiffusion as JumpDiffusion
    from seedslib.models.kinds import System as System
    from seedslib.models.kinds import inputs_of as inputs_of
    from seedslib.models.linear import LinearSystem as LinearSystem
    from seedslib.models.linear import van_loan as van_loan
    from seedslib.models.maps import Noise as Noise
    from seedslib.models.maps import StochasticMap as StochasticMap
    from seedslib.models.past_states import by_arrival as by_arrival
    from seedslib.models.past_states import with_past_states as with_past_states
    from seedslib.models.structural import Structural as Structural
    from seedslib.models.structural import level as level
    from seedslib.models.structural import regression as regression
    from seedslib.models.structural import season as season
    from seedslib.models.structural import trend as trend
    from seedslib.models.switching import SwitchingSystem as SwitchingSystem
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__)
