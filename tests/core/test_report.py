"""The page of a report: pictures embedded, texts escaped, nothing loaded from elsewhere; charts in the data's units."""

import base64
import re
import xml.etree.ElementTree as ET

import cv2
import numpy as np

from core.report import Chart, Section, Table, html_page

EVIL = "<script>alert('&')</script>"


def test_a_page_holds_its_pictures_and_escapes_its_texts():
    red = np.zeros((4, 6, 3), np.uint8)
    red[..., 0] = 255
    chart = Chart(1.0, 1.0, x_ticks=[(0.5, EVIL)])
    pictures = {"red & small": red, EVIL: chart}
    section = Section(EVIL, EVIL, pictures, Table((EVIL,), [(EVIL,)]), EVIL, (EVIL,), ((EVIL, EVIL),))
    page = html_page("A & B", EVIL, [section])
    assert "A &amp; B" in page and "red &amp; small" in page and "http://" not in page and "https://" not in page
    assert "<script" not in page and page.count("&lt;script") == 11
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (4, 6, 3) and (picture == (0, 0, 255)).all()  # OpenCV has blue first


def test_a_chart_places_values_between_its_margins():
    chart = Chart(10.0, 2.0, x_ticks=[(10.0, "ten")], size=(200, 100))
    chart.bar(0.0, 10.0, 1.0, "#222")
    root = ET.fromstring(chart.svg())
    bar = root.find("rect")
    assert float(bar.get("height")) == (100 - Chart.TOP - Chart.BOTTOM) / 2
    assert float(bar.get("x")) + float(bar.get("width")) == 200 - Chart.RIGHT - 1
    assert [text.text for text in root.findall("text")] == ["ten"]
