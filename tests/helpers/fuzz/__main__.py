"""A campaign in a process of its own; see the package."""

import json
import logging
import sys
import warnings

from helpers.fuzz.campaign import campaign, limit_memory

logging.disable(logging.CRITICAL)
warnings.simplefilter("ignore")
limit_memory()
print(json.dumps(campaign(sys.argv[1], *map(int, sys.argv[2:]))))
