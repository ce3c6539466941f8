// Rays and closest points by Embree 3: an oracle that shares nothing with this library. Tests only.
#pragma once
#include <embree3/rtcore.h>

#include <cstring>
#include <span>

#include "tests/brute_force.hpp"

namespace hapticlod::test {

class EmbreeOracle {
public:
    EmbreeOracle(std::span<const float> vertices, std::span<const std::uint32_t> faces)
        : triangles_(corners_of(vertices, faces)), device_(rtcNewDevice("threads=1")), scene_(rtcNewScene(device_)) {
        rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
        RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
        std::memcpy(
            rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, vertices.size() / 3),
            vertices.data(), vertices.size_bytes());
        std::memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, faces.size() / 3),
                    faces.data(), faces.size_bytes());
        rtcSetGeometryPointQueryFunction(geometry, &EmbreeOracle::visit);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(scene_, geometry);
        rtcReleaseGeometry(geometry);
        rtcCommitScene(scene_);
    }
    ~EmbreeOracle() {
        rtcReleaseScene(scene_);
        rtcReleaseDevice(device_);
    }
    EmbreeOracle(const EmbreeOracle&) = delete;
    EmbreeOracle& operator=(const EmbreeOracle&) = delete;

    // Length along the unit direction to the first triangle; infinity where there is none.
    [[nodiscard]] double first_hit(const Point& from, const Point& direction) const {
        RTCRayHit hit{};
        RTCRay& ray = hit.ray;
        ray.org_x = static_cast<float>(from[0]), ray.org_y = static_cast<float>(from[1]);
        ray.org_z = static_cast<float>(from[2]);
        ray.dir_x = static_cast<float>(direction[0]), ray.dir_y = static_cast<float>(direction[1]);
        ray.dir_z = static_cast<float>(direction[2]);
        ray.tfar = std::numeric_limits<float>::infinity();
        ray.mask = ~0u;
        hit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcIntersect1(scene_, &context, &hit);
        return hit.hit.geomID == RTC_INVALID_GEOMETRY_ID ? std::numeric_limits<double>::infinity() : double{ray.tfar};
    }

    // Distance to the closest point. Embree finds the triangles, double precision the last digits.
    [[nodiscard]] double closest(const Point& at) const {
        Visit best{this, at, std::numeric_limits<double>::infinity()};
        RTCPointQuery query{};
        query.x = static_cast<float>(at[0]), query.y = static_cast<float>(at[1]), query.z = static_cast<float>(at[2]);
        query.radius = std::numeric_limits<float>::infinity();
        RTCPointQueryContext context;
        rtcInitPointQueryContext(&context);
        rtcPointQuery(scene_, &query, &context, nullptr, &best);
        return best.distance;
    }

private:
    struct Visit {
        const EmbreeOracle* oracle;
        Point at;
        double distance;
    };
    static bool visit(RTCPointQueryFunctionArguments* args) {
        Visit& best = *static_cast<Visit*>(args->userPtr);
        const double d = length(best.at - closest_on(best.at, best.oracle->triangles_[args->primID]));
        if (d >= best.distance) return false;
        best.distance = d;
        // A little more, for the boxes are bounded in float.
        args->query->radius = static_cast<float>(d * 1.000001 + 1e-6);
        return true;
    }

    std::vector<Corners> triangles_;
    RTCDevice device_;
    RTCScene scene_;
};

}  // namespace hapticlod::test
