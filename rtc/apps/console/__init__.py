"""The web console: a gateway between a cluster and pages in a browser.

It is a client of the cluster like any other. It keeps nothing that the cluster does not know, and may be killed.
"""
