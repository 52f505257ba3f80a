"""Round an imported world: the sky behind its openings, its lidar map, its rooms' names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gn0.errors import SceneError
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.scenes.check import check_scene
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.rays import RayCaster
from gn0.scenes.rooms import RoomMap, guess_room_type
from gn0.scenes.ros_map import raise_walls, roomy_cells
from gn0.scenes.scene_sources import import_scene
from gn0.scenes.world_map import register_map, register_maps
from gn0.scenes.world_mesh import WorldMeshes
from gn0.scenes.world_sky import close_openings
from gn0.viewer.see_through import check_see_through


def draw_grid(size: float = 0.05) -> OccupancyGrid:
    """Two rooms of 5 x 4 and 3 x 4 m with a door between them, walls 15 cm thick."""
    cells = np.full((100, 190), UNKNOWN, np.uint8)
    cells[7:93, 7:183] = OCCUPIED
    cells[10:90, 10:110] = FREE
    cells[10:90, 113:180] = FREE
    cells[40:60, 110:113] = FREE
    cells[30:38, 20:44] = OCCUPIED  # a table
    return OccupancyGrid(cells, size, (-3.0, 1.0))


def shell_of(grid: OccupancyGrid) -> WorldMeshes:
    return raise_walls(grid, roomy_cells(grid))


def looks(grid: OccupancyGrid, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    xy = grid.centres_of(np.argwhere(grid.cells == FREE))
    start = np.column_stack([xy[rng.integers(0, len(xy), count)], rng.uniform(0.3, 1.7, count)])
    way = rng.normal(size=(count, 3))
    return start, way / np.linalg.norm(way, axis=1, keepdims=True)


def without_window(mesh: SceneMesh) -> SceneMesh:
    """The shell without the upper half of its eastern walls: a wide hole."""
    corners = mesh.corners()
    x = mesh.vertices[:, 0].max()
    east = (np.abs(corners[:, :, 0] - x) < 1e-6).all(axis=1) & (corners[:, :, 2].max(axis=1) > 1.5)
    return mesh.select(~east)


def test_sky_hangs_behind_every_hole_and_nowhere_else():
    grid = draw_grid()
    whole = shell_of(grid)
    rooms = RoomMap((), np.where(grid.cells == FREE, 0, -1).astype(np.int32))
    assert close_openings(whole, rooms, grid, 0) is whole  # nothing to see out of
    holed = WorldMeshes(without_window(whole.visual), whole.collision, whole.paints, [], [], [], [])
    start, way = looks(grid)
    lost = ~RayCaster(holed.visual).occluded(start, way)
    assert lost.mean() > 0.01
    closed = close_openings(holed, rooms, grid, 0)
    still = ~RayCaster(closed.visual).occluded(start, way)
    assert still.mean() < 0.0005
    sky = closed.visual.material == closed.sky_paint
    corners = closed.visual.corners()[sky]
    inward = np.array((4.0, 3.0, 1.2)) - corners.mean(axis=1)
    assert ((closed.visual.normals()[sky] * inward).sum(axis=1) > 0).all()
    assert corners[:, :, 0].min() > 3.0  # behind the east wall, not all round the house
    picture = closed.paints[closed.sky_paint].picture
    assert picture is not None
    assert picture[:20].mean() > 0.5 > picture[-8:].mean()  # bright sky above dark trees


@pytest.mark.parametrize(
    ("dx", "dy", "turns"), [(0.0, 0.0, 0), (0.35, -0.6, 0), (-2.0, 1.5, 1), (40.0, 3.0, 2)]
)
def test_a_map_that_is_off_is_laid_over_the_world_and_the_offset_said(dx, dy, turns):
    ours = draw_grid()
    # the map's frame is such that turning and shifting it gives ours
    cells = np.rot90(ours.cells, turns)  # array rows grow with y, so this turns clockwise
    walls = ours.centres_of(np.argwhere(ours.cells == OCCUPIED)) - (dx, dy)
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[turns]
    back = walls @ np.array([[c, -s], [s, c]], float)  # the inverse turn
    rc = np.argwhere(cells == OCCUPIED)
    first = rc.min(axis=0)
    origin = back.min(axis=0) - (first[::-1] + 0.5) * ours.resolution
    lidar = OccupancyGrid(np.ascontiguousarray(cells), ours.resolution, tuple(origin))
    fit = register_map(lidar, ours)
    assert fit.fits
    assert fit.share > 0.99
    assert fit.turns == turns
    assert (fit.dx, fit.dy) == pytest.approx((dx, dy), abs=0.051)
    assert f"{fit.dx:+.2f}" in fit.told()


def test_a_map_of_another_place_is_not_laid_over_by_force():
    other = np.full((80, 80), FREE, np.uint8)
    other[::16, :] = other[:, ::16] = OCCUPIED
    fit = register_map(OccupancyGrid(other, 0.05, (0.0, 0.0)), draw_grid())
    assert not fit.fits
    assert "another place" in fit.told()


def test_a_damaged_map_beside_a_world_is_said_and_is_no_stopper(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "map.yaml").write_text("image: gone.pgm\nresolution: 0.05\n")
    found = dict(register_maps(tmp_path, draw_grid()))
    assert list(found) == ["maps/map.yaml"]
    assert isinstance(found["maps/map.yaml"], str)


def test_a_large_hall_never_gets_a_small_rooms_name():
    sofa_corner = ["sofa", "coffee table", "television"]
    assert guess_room_type(sofa_corner, 25.0) == "living room"
    assert guess_room_type([*sofa_corner, *["crate"] * 40], 600.0) == "room"
    assert guess_room_type(["toilet"], 90.0) == "room"
    assert guess_room_type(["shelf"] * 30 + ["pallet"], 600.0) == "storage hall"


def test_a_room_of_mixed_furniture_gets_no_name():
    assert guess_room_type(["bed", "stove"], 20.0) == "room"
    assert guess_room_type(["bed", "nightstand", "desk"], 20.0) == "bedroom"


def write_map(folder, grid: OccupancyGrid) -> None:
    shade = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
    grey = np.vectorize(shade.get)(grid.cells[::-1]).astype(np.uint8)
    Image.fromarray(grey).save(folder / "map.pgm")
    (folder / "map.yaml").write_text(
        f"image: map.pgm\nresolution: {grid.resolution}\norigin: [{grid.origin[0]}, "
        f"{grid.origin[1]}, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def test_a_ros_map_becomes_a_shell_that_one_can_walk_in_at_once(tmp_path):
    grid = draw_grid()
    write_map(tmp_path, grid)
    scene = import_scene(tmp_path / "map.yaml", tmp_path / "out", density=400)
    np.testing.assert_array_equal(scene.grid.cells, grid.cells)
    assert scene.grid.origin == pytest.approx(grid.origin)
    areas = np.asarray(NavigationMap(scene.grid, 0.2).region_areas)
    assert areas[0] > 20
    assert len(scene.rooms) == 2
    assert [f for f in check_scene(scene) if f.level == "error"] == []
    cloud = scene.gaussians
    z, tone = cloud.means[:, 2], cloud.albedo.mean(axis=1)
    low, high = tone[(z > 0.2) & (z < 0.9)], tone[(z > 1.1) & (z < 2.4)]
    assert high.mean() > 1.7 * low.mean()  # two tones
    assert check_see_through(scene) == []
    floor = scene.gaussians.select(scene.gaussians.means[:, 2] < 1.0)
    [finding] = check_see_through(replace(scene, load_cloud=lambda: floor, cloud_hash=""))
    assert (finding.level, finding.code) == ("warning", "see-through")


def test_the_shell_of_a_map_has_no_gap():
    grid = draw_grid()
    shell = shell_of(grid).visual
    assert RayCaster(shell).occluded(*looks(grid)).all()
    corners = shell.corners()
    middle = corners.mean(axis=1) + 0.03 * shell.normals()
    inside = np.abs(middle[:, 2] - 1.25) < 1.25
    rc = grid.cells_of(middle[inside, :2])
    assert (grid.cells[rc[:, 0], rc[:, 1]] == FREE).all()  # every face looks into a room


def test_a_map_without_a_free_square_metre_is_refused(tmp_path):
    write_map(tmp_path, OccupancyGrid(np.full((40, 40), UNKNOWN, np.uint8), 0.05, (0.0, 0.0)))
    with pytest.raises(SceneError, match="no free patch"):
        import_scene(tmp_path / "map.yaml", tmp_path / "out")
    assert not (tmp_path / "out").exists()
