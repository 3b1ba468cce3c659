"""What a C++ compiler needs to find `mbocp/receding_horizon.hpp`: python -m mbocp.receding."""

from __future__ import annotations

from mbocp.receding.saved import HEADERS

if __name__ == "__main__":
    print(f"-I{HEADERS}")
