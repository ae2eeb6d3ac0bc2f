"""The page of a report: pictures embedded, texts escaped, nothing loaded from elsewhere."""

import base64
import re

import cv2
import numpy as np

from core.report import Section, Table, html_page

EVIL = "<script>alert('&')</script>"


def test_a_page_holds_its_pictures_and_escapes_its_texts():
    red = np.zeros((4, 6, 3), np.uint8)
    red[..., 0] = 255
    pictures = {"red & small": red, EVIL: "<svg></svg>"}
    section = Section(EVIL, EVIL, pictures, Table((EVIL,), [(EVIL,)]), EVIL, (EVIL,), ((EVIL, EVIL),))
    page = html_page("A & B", EVIL, [section])
    assert "<figure><svg></svg><figcaption>" in page
    assert "A &amp; B" in page and "red &amp; small" in page and "http://" not in page and "https://" not in page
    assert "<script" not in page and page.count("&lt;script") == 10
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (4, 6, 3) and (picture == (0, 0, 255)).all()  # OpenCV has blue first
