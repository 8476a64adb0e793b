// OpenVDB's narrow-band level set tools on one case: the C++ side of grid_peers.py, as the Python module lacks them.
//
// usage: openvdb_peer METHOD NODES AMOUNT BAND THREADS VALUES RESULT
//
// VALUES and RESULT are NODES^3 floats in C order; values from BAND on are left out. AMOUNT is the time of a motion, the
// number of steps of 1/6 of a curvature flow, or the half width in cells of the band in which distances are asked for.
// Prints steps, CPU seconds of all threads and wall seconds: what the tool takes, not the copies from and to the array.

#include <openvdb/openvdb.h>
#include <openvdb/tools/Dense.h>
#include <openvdb/tools/FastSweeping.h>
#include <openvdb/tools/LevelSetAdvect.h>
#include <openvdb/tools/LevelSetFilter.h>
#include <openvdb/tools/LevelSetRebuild.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <tbb/global_control.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

using openvdb::Coord;
using openvdb::CoordBBox;
using openvdb::FloatGrid;
using Dense = openvdb::tools::Dense<float, openvdb::tools::LayoutZYX>;

namespace {

// Velocities in cells: Enright's on a unit cube with nodes on its walls, or unit speed away from the grid's middle, which
// is the unit normal speed of a sphere there. One type for both, as each takes half a minute to compile.
struct Velocity {
    using ValueType = float;
    using VectorType = openvdb::Vec3f;

    Velocity(int nodes, bool enright) : cells(nodes - 1), enright(enright) {}
    openvdb::math::Transform transform() const { return openvdb::math::Transform(); }
    VectorType operator()(const openvdb::Vec3d& xyz, float time) const {
        if (enright) return VectorType(cells * field(xyz / cells, time));
        return VectorType((xyz - openvdb::Vec3d(0.5 * cells)).unit());
    }
    VectorType operator()(const Coord& ijk, float time) const { return (*this)(ijk.asVec3d(), time); }

    double cells;
    bool enright;
    openvdb::tools::EnrightField<float> field;
};

FloatGrid::Ptr narrowBand(Dense& values, float band) {
    auto grid = FloatGrid::create(band);
    grid->setGridClass(openvdb::GRID_LEVEL_SET);
    auto accessor = grid->getAccessor();
    for (auto ijk = values.bbox().begin(); ijk; ++ijk) {
        const float value = values.getValue(*ijk);
        if (std::abs(value) < band) accessor.setValue(*ijk, value);
    }
    openvdb::tools::signedFloodFill(grid->tree());
    return grid;
}

size_t run(const std::string& method, FloatGrid::Ptr& grid, int nodes, double amount) {
    if (method == "offset") {
        openvdb::tools::LevelSetFilter<FloatGrid> filter(*grid);
        filter.offset(float(-amount));  // adds to the values, so that negative is outwards
        return size_t(std::ceil(amount / 0.5 - 1e-3));
    }
    if (method == "curvature") {
        openvdb::tools::LevelSetFilter<FloatGrid> filter(*grid);
        const auto steps = size_t(std::lround(amount));
        for (size_t step = 0; step < steps; ++step) filter.meanCurvature();
        return steps;
    }
    if (method == "advect" || method == "enright") {
        openvdb::tools::LevelSetAdvection<FloatGrid, Velocity> advection(*grid, Velocity(nodes, method == "enright"));
        return advection.advect(0.0f, float(amount));
    }
    if (method == "sweep") {
        grid = openvdb::tools::sdfToSdf(*grid, 0.0f, 1);
        return 1;
    }
    if (method == "rebuild") {
        grid = openvdb::tools::levelSetRebuild(*grid, 0.0f, float(amount));
        return 1;
    }
    throw std::invalid_argument("unknown method " + method);
}

double cpuSeconds() {
    timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 8) return 2;
    const std::string method = argv[1];
    const int nodes = std::stoi(argv[2]);
    const double amount = std::stod(argv[3]);
    const float band = std::stof(argv[4]);
    const tbb::global_control threads(tbb::global_control::max_allowed_parallelism, std::stoul(argv[5]));
    openvdb::initialize();

    std::vector<float> values(size_t(nodes) * nodes * nodes);
    const auto bytes = std::streamsize(values.size() * sizeof(float));
    if (!std::ifstream(argv[6], std::ios::binary).read(reinterpret_cast<char*>(values.data()), bytes)) return 3;
    Dense dense(CoordBBox(Coord(0), Coord(nodes - 1)), values.data());
    auto grid = narrowBand(dense, band);

    const double cpu = cpuSeconds();
    const auto wall = std::chrono::steady_clock::now();
    const size_t steps = run(method, grid, nodes, amount);
    const double used = cpuSeconds() - cpu;
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - wall;

    openvdb::tools::copyToDense(*grid, dense);
    std::ofstream(argv[7], std::ios::binary).write(reinterpret_cast<const char*>(values.data()), bytes);
    std::printf("{\"steps\": %zu, \"cpu\": %.6f, \"wall\": %.6f}\n", steps, used, passed.count());
    return 0;
}
