"""The live page: a feed in the loop, and a separate server process for the browsers.

    loop → feed.LiveFeed → pipe → server (hub.Hub → app) → browsers

The feed writes to the pipe without waiting, so no browser can delay the loop. Data that does not
fit is kept for later, then dropped and counted. The server ends when the pipe is closed.
"""
