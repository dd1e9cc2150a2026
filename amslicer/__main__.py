"""python -m amslicer"""

from amslicer.cli import main

raise SystemExit(main())
