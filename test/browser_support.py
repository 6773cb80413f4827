"""Headless Chromium for the tests of the pages, through ChromeDriver's own protocol (W3C WebDriver)."""
from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
import urllib.error
import urllib.request

#: nothing that looks for a network, which need not be there
_ARGUMENTS = ('--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
              '--disable-background-networking', '--disable-component-update', '--disable-sync', '--hide-scrollbars')


def missing() -> str:
    """What is not installed, empty where all is."""
    absent = [name for name in ('chromium', 'chromedriver') if shutil.which(name) is None]
    return f"{' and '.join(absent)} not installed" if absent else ''


class Browser:
    """One window; a context manager."""

    def __enter__(self):
        with socket.socket() as free:
            free.bind(('127.0.0.1', 0))
            port = free.getsockname()[1]
        self._profile = tempfile.mkdtemp()
        self._url = f'http://127.0.0.1:{port}'
        self._driver = subprocess.Popen(['chromedriver', f'--port={port}'], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL, start_new_session=True)
        options = {'args': [*_ARGUMENTS, f'--user-data-dir={self._profile}'], 'binary': shutil.which('chromium')}
        deadline = time.monotonic() + 60.0
        while True:
            try:
                answer = self._post('/session', {'capabilities': {'alwaysMatch': {'goog:chromeOptions': options}}})
                break
            except urllib.error.URLError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.2)
        self._url += f"/session/{answer['sessionId']}"
        return self

    def __exit__(self, *exception):
        os.killpg(self._driver.pid, signal.SIGTERM)
        self._driver.wait()
        shutil.rmtree(self._profile, ignore_errors=True)

    def _post(self, path: str, content: dict):
        request = urllib.request.Request(self._url + path, json.dumps(content).encode(),
                                         {'Content-Type': 'application/json'})
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(request, timeout=240.0) as reply:
            return json.load(reply)['value']

    def open(self, path, width: int, media: str = 'screen') -> None:
        """The page `path`, `width` pixels wide, every folded part open."""
        self.command('Emulation.setDeviceMetricsOverride', width=width, height=900, deviceScaleFactor=1, mobile=False)
        self.command('Emulation.setEmulatedMedia', media=media)
        self._post('/url', {'url': f'file://{path}'})
        self.run('document.querySelectorAll("details").forEach(d => { d.open = true; })')

    def command(self, name: str, **parameters):
        """A command of the DevTools protocol."""
        return self._post('/goog/cdp/execute', {'cmd': name, 'params': parameters})

    def run(self, script: str):
        """What the script returns."""
        return self._post('/execute/sync', {'script': script, 'args': []})

    def too_wide(self) -> list[str]:
        """Elements that reach beyond the page, or hold more than they show."""
        return self.run('''
            const width = document.documentElement.clientWidth;
            return [...document.querySelectorAll('main *')]
              .filter(e => e.getBoundingClientRect().right > width + 1
                           || (e.matches('table, td, th, pre, div, section') && e.scrollWidth > e.clientWidth + 1
                               && e.clientWidth > 0))
              .map(e => e.tagName + ' ' + e.className + ': ' + e.textContent.slice(0, 60));''')


def check_page(browser: Browser, path) -> None:
    """Nothing is wider than a screen, a phone or a sheet of A4 with its margins, and nothing was fetched."""
    for width, media in ((1200, 'screen'), (850, 'screen'), (400, 'screen'), (688, 'print')):
        browser.open(path, width, media)
        wide = browser.too_wide()
        assert not wide, f'{width} px, {media}: {wide[:5]}'
        # figures for phones are too tall for a sheet
        both = browser.run("""return [...document.querySelectorAll('img.narrow')].map(
            e => [e.offsetParent !== null, e.previousElementSibling.offsetParent !== null])""")
        assert not any(shown[int(width == 400)] for shown in both)
    fetched = browser.run("return performance.getEntriesByType('resource').map(e => e.name)")
    assert all(name.startswith('data:') for name in fetched)
