"""The explorer: a picture that is turned, edited and clicked, in a browser or a notebook.

`document` is the scene on the screen, `session` what one page is sent next, `frames` how pictures
become bytes: these know neither sockets nor notebooks. `painter` renders in a thread, `explorer`
answers messages. `page` moves messages over a websocket, `widget` through a notebook's channel.
"""
