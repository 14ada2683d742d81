"""The live page: a feed in the loop, and a server of its own that no browser can make it wait for.

    loop → feed.LiveFeed → pipe → server (hub.Hub → app) → browsers

The feed writes to a pipe without ever waiting; what does not fit is kept for later, then dropped
and counted. The server lives as long as the pipe.
"""
