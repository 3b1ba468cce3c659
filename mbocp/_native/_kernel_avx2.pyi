from mbocp._native._kernel import *
