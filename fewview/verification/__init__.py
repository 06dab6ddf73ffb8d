"""Does a pair make one plausible room? Both scans drawn together from above, and a small network.

The idea is SALVe's (Lambert et al., ECCV 2022), which verifies sparse panoramas so.
"""

from fewview.verification.network import VerifierNetwork, VerifierNetworkConfig
from fewview.verification.verify import plausibility, shipped_network

__all__ = ["VerifierNetwork", "VerifierNetworkConfig", "plausibility", "shipped_network"]
